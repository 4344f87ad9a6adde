/** The words of the field at headings and columns: each can be explained, by the keyboard. */

/** Headings that anyone reads without a glossary. */
const PLAIN_HEADINGS = /^(Ready|Moving|No response|Next|First steps|From a measured pile to a weighed dose|Waiting|Request|New token|How the data were read|Only what differs|Comparison|Page not found)$/
/** Titles of columns that a newcomer to powder weighing would ask about. */
const TERMS = /^(SD|n|U|p|Bias|Reading|True mass|Residual|Prior|Pitch|Controller|Preset|Levels?|Shakes?|Sets?|Learnt|Parameter sets|Calibrated sets|.*\|.*\|.*|.*\bSD\b.*|\d+ %)( \(.*\))?$/

/** Headings and columns of the view that name a term and do not explain it. */
export function unexplained(page) {
  return page.evaluate(
    ([plain, terms]) => {
      const explains = (place) => !!place?.querySelector('.explain button')
      const visible = (selector) => [...document.querySelectorAll(selector)].filter((element) => element.checkVisibility())
      const headings = visible('main h1, main h2').filter((heading) => !new RegExp(plain).test(heading.textContent.trim()) && !explains(heading.closest('.heading') ?? heading.closest('.report section')))
      const columns = visible('main thead th').filter((column) => new RegExp(terms).test(column.textContent.trim()) && !explains(column) && column.closest('[data-file]'))
      return [...headings, ...columns].map((element) => `${element.localName} ${element.textContent.trim()}`)
    },
    [PLAIN_HEADINGS.source, TERMS.source],
  )
}

/** Opens every explanation of the view by the keyboard; what it says, by its word. */
export async function explanations(page) {
  const said = new Map()
  for (const button of await page.locator('main .explain button:visible').all()) {
    const word = (await button.getAttribute('aria-label')).match(/^What is meant by (.*)\?$/)[1]
    if (said.has(word)) continue
    await button.focus()
    await page.keyboard.press('Enter')
    const note = page.locator('.explain [popover]:popover-open')
    await note.waitFor()
    await page.waitForFunction(() => !/ …( |$)/.test(document.querySelector('.explain [popover]:popover-open')?.textContent ?? ''))
    const box = await note.boundingBox()
    const { width, height } = page.viewportSize()
    const within = box.x >= 0 && box.y >= 0 && box.x + box.width <= width + 0.5 && box.y + box.height <= height + 0.5
    said.set(word, { text: await note.evaluate((it) => it.textContent.replace(it.querySelector('strong').textContent, '').replace('Glossary', '').trim()), within })
    await page.keyboard.press('Escape')
    await note.waitFor({ state: 'hidden' })
  }
  return said
}
