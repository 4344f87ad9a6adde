/** Where a small panel goes: beside its button, within the window. */

const GAP = 4
/** Room that stays free at the edges of the window, px. */
const EDGE = 14
/** With this room below, a panel opens below. */
const ENOUGH = 300

/** Puts a panel below its button, or above it where there is more room; what does not fit scrolls. For a panel that moves with the page. */
export function putNear(box: HTMLElement, button: HTMLElement): void {
  const { top, bottom, left, right } = button.getBoundingClientRect()
  const { clientWidth: width, clientHeight: height } = document.documentElement
  const below = height - bottom - GAP - EDGE
  const above = top - GAP - EDGE
  const under = below >= ENOUGH || below >= above
  // Counted from the top in both cases: what `bottom` is counted from grows with the page.
  box.style.top = `${scrollY + (under ? bottom + GAP : top - GAP)}px`
  box.style.translate = under ? 'none' : '0 -100%'
  box.style.maxHeight = `${Math.max(under ? below : above, 120)}px`
  // It hangs from the side of the button that has more room on its other side.
  const leftwards = right > width / 2
  box.style.right = leftwards ? `${Math.max(EDGE, width < 560 ? EDGE : width - right)}px` : 'auto'
  box.style.left = leftwards ? 'auto' : `${Math.max(EDGE, width < 560 ? EDGE : left)}px`
}
