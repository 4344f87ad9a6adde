/** How lines and points of up to 20 things are told apart: by letter, by colour, and by dashes or shapes, so that no two look alike without colour. */

/** Colours of lines.css, far apart for every kind of colour vision (`tests/curves.test.mjs` measures how far). */
export const COLOURS = 5
const DASHES = ['', '8 3', '2 3', '9 3 2 3'] as const

/** A, B, C… in the order of the address. */
export const letterOf = (k: number) => String.fromCharCode(65 + k)
export const colourOf = (k: number) => `var(--line-${k % COLOURS})`
const group = (k: number) => Math.floor(k / COLOURS) % DASHES.length
/** For `stroke-dasharray`; undefined for an unbroken line. */
export const dashOf = (k: number): string | undefined => DASHES[group(k)] || undefined

/** Outline of the point at (x, y): circle, square, triangle or diamond, as large as a circle of radius r. */
export function pointOf(k: number, x: number, y: number, r: number): string {
  const s = r * 0.9
  const t = r * 1.25
  return [
    `M${x - r} ${y}a${r} ${r} 0 1 0 ${2 * r} 0a${r} ${r} 0 1 0 ${-2 * r} 0z`,
    `M${x - s} ${y - s}h${2 * s}v${2 * s}h${-2 * s}z`,
    `M${x} ${y - t}l${t} ${1.8 * t}h${-2 * t}z`,
    `M${x} ${y - t}l${t} ${t}l${-t} ${t}l${-t} ${-t}z`,
  ][group(k)] as string
}

/** Heights of labels that are wanted at these points: as near as they can be without coming closer than `gap` pixels to one within `wide` pixels beside them, between `top` and `bottom`. */
export function spread(points: (readonly [x: number, y: number])[], wide: number, gap: number, top: number, bottom: number): number[] {
  const x = (k: number) => points[k]?.[0] ?? 0
  const at = points.map(([, y]) => y)
  const left = points.map((_, k) => k).sort((a, b) => x(a) - x(b))
  for (let from = 0; from < left.length; ) {
    let to = from + 1
    while (to < left.length && x(left[to] as number) - x(left[to - 1] as number) < wide) to++
    const column = left.slice(from, to).sort((a, b) => (at[a] as number) - (at[b] as number))
    const heights = apart(column.map((k) => at[k] as number), gap)
    column.forEach((k, n) => (at[k] = Math.max(top + n * gap, Math.min(heights[n] ?? 0, bottom - (column.length - 1 - n) * gap))))
    from = to
  }
  return at
}

/** Ascending values moved by as little as makes them `gap` apart: neighbours that would overlap form a block around their mean. */
function apart(values: number[], gap: number): number[] {
  const blocks: { sum: number; count: number }[] = []
  values.forEach((value, n) => {
    let block = { sum: value - n * gap, count: 1 }
    for (let before = blocks.at(-1); before && before.sum / before.count > block.sum / block.count; before = blocks.at(-1)) {
      blocks.pop()
      block = { sum: before.sum + block.sum, count: before.count + block.count }
    }
    blocks.push(block)
  })
  return blocks.flatMap(({ sum, count }) => Array.from({ length: count }, () => sum / count)).map((height, n) => height + n * gap)
}
