/** Debian's Chromium without a window, with what the tests look for on every view. */
import { chromium } from 'playwright-core'
import assert from 'node:assert/strict'
import { existsSync, mkdirSync, readFileSync } from 'node:fs'
import { createRequire } from 'node:module'
import { fileURLToPath } from 'node:url'

const CHROMIUM = [process.env.CHROMIUM, '/usr/bin/chromium', '/usr/bin/chromium-browser', '/usr/bin/google-chrome'].find((path) => path && existsSync(path))
const ARGS = ['--headless', '--no-sandbox', '--disable-gpu', '--disable-quic', '--no-first-run', '--disable-background-networking', '--disable-component-update', '--disable-sync']
const AXE = readFileSync(createRequire(import.meta.url).resolve('axe-core/axe.min.js'), 'utf8')
const SHOTS = fileURLToPath(new URL('screenshots', import.meta.url))
// FLIP_SLOW=1: a processor four times as slow, and every answer 0.3 to 1 s late, so that a test that does not wait is seen.
const SLOW = process.env.FLIP_SLOW === '1'
const late = () => new Promise((resolve) => setTimeout(resolve, 300 + 700 * Math.random()))

export async function openBrowser(base) {
  // Playwright gives each launch a user data folder of its own.
  const browser = await chromium.launch({ executablePath: CHROMIUM, args: ARGS })
  const complaints = []

  /** A tab of a browser of its own. */
  async function tab(options = {}) {
    return beside(await browser.newContext({ viewport: { width: 1400, height: 900 }, acceptDownloads: true, ...options }))
  }

  /** One more tab of a browser: the same connections, the same workers. It reports what the console and the network complain about. */
  async function beside(context) {
    const page = await context.newPage()
    if (SLOW) await slow(page)
    page.on('console', (message) => {
      // The browser logs every answer of 4xx; refusals that tests provoke are no fault of the page.
      if (['error', 'warning'].includes(message.type()) && !/responded with a status of 4\d\d/.test(message.text())) complaints.push(message.text())
    })
    page.on('pageerror', (error) => complaints.push(error.message))
    page.on('request', (request) => {
      const address = request.url()
      if (!address.startsWith(base) && !address.startsWith('blob:')) complaints.push(`asked for ${address}`)
    })
    return page
  }

  /** Slows a tab, and what its tests answer in the place of the service. */
  async function slow(page) {
    const network = await page.context().newCDPSession(page)
    await network.send('Emulation.setCPUThrottlingRate', { rate: 4 })
    // Not by a route: that would take the browser's cache away.
    network.on('Fetch.requestPaused', ({ requestId }) => late().then(() => network.send('Fetch.continueRequest', { requestId })).catch(() => undefined))
    await network.send('Fetch.enable', { patterns: [{ urlPattern: '*/v1/*' }] })
    const route = page.route.bind(page)
    // A test may have gone on to another view before its answer.
    page.route = (address, answer, options) => route(address, (asked) => late().then(() => answer(asked)).catch(() => undefined), options)
  }

  /** Goes to a view and waits until its first heading and data are there. */
  async function open(page, hash = '') {
    await page.goto('about:blank')
    await page.goto(`${base}/#/${hash}`)
    await page.locator('main h1').waitFor()
  }

  return { browser, tab, beside, open, complaints }
}

/** Runs assertions until they hold, and gives what they give: what an action changes is not there at once. Fails as they failed last. */
export async function holds(check) {
  for (const end = Date.now() + 30_000; ; await new Promise((resolve) => setTimeout(resolve, 50))) {
    try {
      return await check()
    } catch (error) {
      if (Date.now() > end) throw error
    }
  }
}

/** Asks until the answer is what is wanted, a value or an expression that its text matches. */
export const becomes = (ask, wanted) =>
  holds(async () => {
    const found = await ask()
    if (wanted instanceof RegExp) assert.match(String(found), wanted)
    else assert.deepEqual(found, wanted)
  })

/** Keeps the token as the dialog would. */
export async function unlock(page, token) {
  await page.getByRole('button', { name: /Read only|Token set/ }).click()
  await page.getByRole('dialog').getByLabel('Token').fill(token)
  const use = page.getByRole('button', { name: 'Use this token' })
  await use.click()
  // One that was set before is set until this one is known: the dialog stays open until then.
  await use.waitFor({ state: 'detached' })
  await page.getByRole('button', { name: /Token set/ }).waitFor()
}

/** Presses the button that opens a form at the side, and gives the panel. */
export async function openPanel(page, button) {
  await page.getByRole('button', { name: button, exact: true }).click()
  const panel = page.locator('dialog[open]')
  await panel.locator('form').first().waitFor()
  return panel
}

/** Whether the page is no wider than its window, once the layout has settled: after a resize scripts and observers still change it. */
export async function fits(page) {
  const settled = page.waitForFunction(() => document.documentElement.scrollWidth <= innerWidth, undefined, { timeout: 30_000 })
  return settled.then(() => true, () => false)
}

/** What axe finds wrong, by rule and place. */
export async function accessibilityFaults(page) {
  // Under the page's policy no script may be injected as a tag; evaluating one is the debugger's, not the page's.
  await page.evaluate(AXE)
  const { violations } = await page.evaluate(() => globalThis.axe.run(document, { resultTypes: ['violations'] }))
  return violations.flatMap((rule) => rule.nodes.map((node) => `${rule.id}: ${node.target.join(' ')}: ${node.failureSummary}`))
}

/** Heading and cells of a table as its CSV must hold them, drawn whole as on paper. */
export function tableCells(table) {
  return table.evaluate((element) => {
    const plain = (cell) => {
      const time = cell.querySelector('time')
      const text = time ? time.getAttribute('datetime') : cell.textContent.trim()
      return text === '–' ? '' : text.replaceAll('−', '-').replaceAll('\u2009', '')
    }
    dispatchEvent(new Event('beforeprint'))
    const rows = [...element.querySelectorAll('tr')].map((row) => [...row.children].filter((cell) => !cell.classList.contains('no-print') && !cell.classList.contains('empty')))
    dispatchEvent(new Event('afterprint'))
    return rows.filter((cells) => cells.length > 0).map((cells) => cells.map(plain))
  })
}

/** Presses the CSV button of the table with this caption and reads the file; `button` is its name. */
export async function csvOf(page, caption, button = `CSV of ${caption}`) {
  const [file] = await Promise.all([page.waitForEvent('download'), page.getByRole('button', { name: button, exact: true }).click()])
  return { name: file.suggestedFilename(), rows: parseCsv(readFileSync(await file.path(), 'utf8')) }
}

/** The CSV of the table with this caption, which is what the table shows: rows that arrive between the two are asked for again. */
export const csvAsShown = (page, caption) =>
  holds(async () => {
    const { rows } = await csvOf(page, caption)
    assert.deepEqual(rows, await tableCells(page.getByRole('table', { name: caption, exact: true })))
    return rows
  })

/** Cells of RFC 4180 text whose lines end in CRLF. */
function parseCsv(text) {
  const rows = [[]]
  for (const [, quoted, plain, end] of text.matchAll(/(?:"((?:[^"]|"")*)"|([^",\r\n]*))(,|\r\n)/g)) {
    rows.at(-1).push(quoted?.replaceAll('""', '"') ?? plain)
    if (end !== ',') rows.push([])
  }
  rows.pop()
  return rows
}

/** A picture for a person to look at. */
export async function picture(page, name) {
  mkdirSync(SHOTS, { recursive: true })
  await page.screenshot({ path: `${SHOTS}/${name}.png`, fullPage: true })
}
