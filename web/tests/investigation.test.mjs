/** Investigations, in a real Chromium before a real `flip serve`: from a file of angles to a report, and everything that a report may hold. */
import assert from 'node:assert/strict'
import { readFileSync } from 'node:fs'
import { after, before, describe, it } from 'node:test'
import { accessibilityFaults, becomes, csvAsShown, fits, holds, openBrowser, openPanel, picture, unlock } from './browser.mjs'
import { humidDays } from './campaign.mjs'
import { startService } from './service.mjs'
import { explanations, unexplained } from './words.mjs'

let service, chromium, page

before(async () => {
  service = await startService()
  chromium = await openBrowser(service.url)
  page = await chromium.tab()
}, { timeout: 120_000 })

after(async () => {
  await chromium?.browser.close()
  await service?.stop()
})

/** Height of the page above its details, in a window of 1440 by 900. */
async function beforeDetails() {
  await page.setViewportSize({ width: 1440, height: 900 })
  await page.evaluate(() => document.fonts.ready)
  const height = await page.locator('.report details').first().evaluate((it) => it.getBoundingClientRect().top + scrollY)
  await page.setViewportSize({ width: 1400, height: 900 })
  return height
}
const threeScreens = () =>
  holds(async () => {
    const height = await beforeDetails()
    assert.ok(height <= 3 * 900, `${height} px`)
  })
const openAll = () => page.getByRole('button', { name: 'Open all details' }).click()
const table = (caption) => page.getByRole('table', { name: caption, exact: true })

/** The view's CSV is what its table shows. */
const csvEqualsTable = (caption) => csvAsShown(page, caption)

/** Presses a button and reads the file it gives. */
async function fileOf(button) {
  const [file] = await Promise.all([page.waitForEvent('download'), page.getByRole('button', { name: button, exact: true }).click()])
  return { name: file.suggestedFilename(), text: readFileSync(await file.path(), 'utf8') }
}

describe('an investigation', () => {
  let id, found

  const upload = (text) => page.getByLabel('Angles of repose (CSV)').setInputFiles({ name: 'angles.csv', mimeType: 'text/csv', buffer: Buffer.from(text) })
  const start = () => page.getByRole('button', { name: 'Start the investigation' }).click()

  it('of a bad file is refused by row and column, and nothing is queued', async () => {
    await chromium.open(page, 'investigations')
    await unlock(page, service.token)
    await openPanel(page, 'Start an investigation')
    await upload('powder,repose_deg,relative_humidity_pct\nsand,28,40\nsand,280,40\n')
    await start()
    await page.getByRole('alert').getByText(/row\[3\]\.repose_deg/).waitFor()
    assert.equal((await service.get('/v1/investigations')).items.length, 0)
  })

  it('of shakes that nobody made is refused too', async () => {
    await chromium.open(page, 'investigations?new=investigation')
    await page.getByLabel(/what fell from the spoon/).check()
    await start()
    await page.getByRole('alert').getByText(/hold 0 spoonfuls/).waitFor()
    await page.getByLabel(/what fell from the spoon/).uncheck()
  })

  it('is started with a file and watched until its report is there', async () => {
    await upload(humidDays())
    await page.getByLabel('Seed').fill('7')
    await page.getByLabel('Campaigns without an effect').fill('99')
    // The form has no field for the number of heaps; fewer than by default are enough here.
    const fewHeaps = (route) => route.continue({ postData: JSON.stringify({ ...route.request().postDataJSON(), budget_runs: 6 }) })
    await page.route('**/v1/investigations', fewHeaps, { times: 1 })
    await start()
    await page.getByRole('heading', { name: /^Investigation/, level: 1 }).waitFor()
    await page.locator('main .badge', { hasText: 'Succeeded' }).waitFor({ timeout: 480_000 })
    id = new URL(page.url()).hash.split('/').at(-1)
    found = await service.get(`/v1/investigations/${id}`)
    assert.deepEqual([found.seed, found.simulations, found.budget_runs], [7, 99, 6])
    await page.getByText(found.report.sentence, { exact: true }).waitFor()
    await page.getByText('chance of evidence this strong if nothing is wrong').waitFor()
    await picture(page, 'investigation-real')
  })

  it('is read in three screens, and all the rest is a click away', async () => {
    await threeScreens()
    await openAll()
  })

  it('draws every recorded condition and holds every row of the file', async () => {
    for (const name of ['Relative humidity', 'Temperature', 'Operator']) await page.getByRole('img', { name: new RegExp(`over ${name}`) }).waitFor()
    await page.getByText('Table of all rows').click()
    const rows = await csvEqualsTable('Rows of the file, before and after')
    assert.equal(rows.length - 1, 72)
    assert.deepEqual(rows.slice(1).map((cells) => cells[2]), found.report.rows.map((row) => row.measured_deg.toFixed(2)))
  })

  it('shows the evidence of every cause, and why some cannot be tested', async () => {
    const rows = await csvEqualsTable('Evidence for each cause')
    assert.equal(rows.length - 1, found.report.evidence.length + found.report.untestable.length)
    assert.deepEqual(rows.slice(1).map((cells) => cells.at(-1)), [...found.report.evidence.map(() => ''), ...found.report.untestable.map((u) => u.reason)])
  })

  it('gives its report as JSON and its predictions as CSV', async () => {
    assert.deepEqual(JSON.parse((await fileOf('Report (JSON)')).text), found.report)
    const { name, text } = await fileOf('Predictions (CSV)')
    assert.equal(name, `investigation-${id}-predict.csv`)
    assert.equal(text, await (await fetch(`${service.url}/v1/investigations/${id}/predict.csv`)).text())
    const [heading, ...lines] = text.trim().split(/\r?\n/)
    assert.equal(heading, 'row,powder,before_deg,before_sd_deg,after_deg,after_sd_deg')
    assert.equal(lines.length, 72)
  })

  it('says the same as its file', async () => {
    const section = (title) => page.locator('.report section', { has: page.getByRole('heading', { name: title, exact: true }) })
    const file = await page.context().newPage()
    await file.goto(`${service.url}/v1/investigations/${id}/report.html`)
    for (const title of ['Null check', 'Provenance']) {
      const same = file.locator('.report section', { has: file.getByRole('heading', { name: title, exact: true }) })
      assert.equal(await section(title).locator('p, dd').allTextContents().then(String), await same.locator('p, dd').allTextContents().then(String))
    }
    await file.close()
  })

  it('opens as a page of its own that needs nothing else', async () => {
    const [report] = await Promise.all([page.waitForEvent('popup'), page.getByRole('link', { name: 'Report (HTML)' }).click()])
    const complaints = []
    report.on('console', (message) => complaints.push(message.text()))
    // A tab that is still on its way to the page cannot be reloaded.
    await report.waitForURL('**/report.html')
    await report.reload()
    assert.equal(await report.locator('h1').textContent(), found.report.sentence)
    // Its style is inline and must be let through.
    assert.notEqual(await report.locator('.badge').evaluate((badge) => getComputedStyle(badge).backgroundColor), 'rgba(0, 0, 0, 0)')
    assert.equal(await report.locator('script').count(), 0)
    assert.deepEqual(complaints, [])
    await report.close()
  })

  it('is listed with its verdict and its sentence', async () => {
    await chromium.open(page, 'investigations')
    await table('Investigations').getByText(found.report.sentence).waitFor()
    await csvEqualsTable('Investigations')
    await table('Investigations').getByRole('link', { name: id.slice(-8) }).waitFor()
  })

  it('is among the jobs and leads back', async () => {
    await chromium.open(page, 'jobs?kind=investigation')
    await table('Jobs').getByRole('link', { name: 'Investigation' }).first().click()
    await page.getByText(found.report.sentence, { exact: true }).waitFor()
  })

  it('is cancelled while it runs', async () => {
    await chromium.open(page, 'investigations')
    await unlock(page, service.token)
    await openPanel(page, 'Start an investigation')
    await upload(humidDays())
    await page.getByLabel('Campaigns without an effect').fill('9999')
    await start()
    await page.getByRole('button', { name: 'Cancel' }).click()
    await page.locator('main .badge', { hasText: 'Cancelled' }).waitFor({ timeout: 120_000 })
  })
})

describe('a report', () => {
  // Which parts a report has is up to its data: these documents are made up, in the form of report.json, so that every part is seen. A test of the service keeps their HTML.
  const ID = '0193a000-0000-7000-8000-0000000000aa'
  const stored = (name) => readFileSync(new URL(`reports/${name}`, import.meta.url), 'utf8')

  async function show(name) {
    const report = JSON.parse(stored(`${name}.json`))
    const job = { id: ID, kind: 'investigation', state: 'succeeded', progress: { fraction: 1, message: '' }, attempts: 1, cancelling: false, created_at: '2026-01-02T03:04:05Z', started_at: '2026-01-02T03:04:06Z', finished_at: '2026-01-02T03:48:06Z', error: null }
    await page.unrouteAll()
    await page.route(`**/v1/investigations/${ID}`, (route) => route.fulfill({ json: { job, powders: ['sand', 'sugar', 'salt'], runs: 23, sessions: 8, covariates: report.curves.map((c) => c.covariate), simulations: 499, seed: 1, simulator: 'base-1', verdict: report.verdict, p_value: report.p_value, sentence: report.sentence, report } }))
    await page.route(`**/v1/investigations/${ID}/report.html?fragment=true`, (route) => route.fulfill({ contentType: 'text/html; charset=utf-8', body: stored(`${name}.html`) }))
    await chromium.open(page, `investigations/${ID}`)
    await page.getByText(report.sentence, { exact: true }).waitFor()
    // The report itself comes after what is said of it.
    await page.locator('.report details').first().waitFor()
  }

  it('begins with its sentence, verdict and p', async () => {
    await show('cause')
    const first = page.locator('main section').first()
    await becomes(() => first.textContent(), /^Humidity makes sugar .*Cause named.*p = 0\.002: chance of evidence this strong if nothing is wrong\. It is the smallest that 499 simulated campaigns can show\./)
  })

  it('has verdict, cause, gain and next experiment in three screens, and the rest as details', async () => {
    const headings = (selector) => page.locator(`.report ${selector}`).allTextContents()
    await becomes(() => headings('section:not(:has(details)) h2'), ['How well each cause explains the data', 'Before and after', 'The next experiment'])
    await becomes(() => headings('details h2'), ['Where measured and simulated angles differ', 'Effect on each powder', 'What these data cannot show', 'Null check', 'Provenance'])
    assert.equal(await page.locator('.report details[open]').count(), 0)
    await threeScreens()
  })

  it('keeps to three screens with tables of any length', async () => {
    const long = stored('cause.html').replaceAll(/<tbody>(.*?)<\/tbody>/gs, (_, rows) => `<tbody>${rows.repeat(20)}</tbody>`)
    await page.route(`**/v1/investigations/${ID}/report.html?fragment=true`, (route) => route.fulfill({ contentType: 'text/html; charset=utf-8', body: long }))
    await page.reload()
    const more = page.getByRole('button', { name: /^Show all \d+ rows$/ })
    await more.first().waitFor()
    await threeScreens()
    const evidence = table('Evidence for each cause')
    await becomes(() => evidence.locator('tbody tr:visible').count(), 6)
    await more.first().focus()
    await page.keyboard.press('Enter')
    await becomes(() => evidence.locator('tbody tr:visible').count(), 80)
    await show('cause')
  })

  it('has a list of contents that follows the reader, beside it or as a menu', async () => {
    for (const width of [1440, 1280, 390]) {
      await page.setViewportSize({ width, height: 900 })
      await show('cause')
      const contents = page.getByRole('navigation', { name: 'Contents' })
      const menu = contents.getByRole('button', { name: /^Contents/ })
      const now = () => contents.locator('[aria-current]').textContent()
      await becomes(() => menu.count(), width < 1100 ? 1 : 0)
      await page.waitForFunction(() => document.querySelector('nav[aria-label=Contents] [aria-current]')?.textContent === 'Result')
      const go = async (name) => {
        if (width < 1100) {
          await menu.focus()
          await page.keyboard.press('Enter')
        }
        await contents.getByRole('link', { name }).focus()
        await page.keyboard.press('Enter')
      }
      await go('Null check')
      await page.waitForURL(/at=null-check/)
      await page.getByRole('table', { name: 'Smallest detectable effects' }).waitFor()
      await becomes(() => page.evaluate(() => document.activeElement.textContent), 'Null check')
      // Read on: the list follows, and stays in the window.
      await page.locator('#before-and-after').evaluate((it) => scrollTo(0, it.getBoundingClientRect().top + scrollY - 100))
      await page.waitForFunction(() => document.querySelector('nav[aria-label=Contents] [aria-current]')?.textContent === 'Before and after')
      await holds(async () => {
        const box = await contents.boundingBox()
        assert.ok(box.y >= 0 && box.y < 200, JSON.stringify(box))
      })
      await becomes(now, 'Before and after')
      assert.ok(await fits(page))
      if (width < 1100) await menu.getByText('Before and after').waitFor()
      await picture(page, `investigation-contents-${width}`)
      assert.deepEqual(await accessibilityFaults(page), [])
    }
    await page.setViewportSize({ width: 1400, height: 900 })
    // A link to a part leads there.
    await chromium.open(page, `investigations/${ID}?at=provenance`)
    await page.locator('#provenance details[open]').waitFor()
    await show('cause')
  })

  it('is printed whole, and as it was afterwards', async () => {
    await page.evaluate(() => dispatchEvent(new Event('beforeprint')))
    await page.emulateMedia({ media: 'print' })
    await becomes(() => page.locator('.report details:not([open])').count(), 0)
    await page.getByRole('table', { name: 'Smallest detectable effects' }).waitFor()
    await becomes(() => page.getByRole('navigation', { name: 'Contents' }).count(), 0)
    await page.emulateMedia({ media: null })
    await page.evaluate(() => dispatchEvent(new Event('afterprint')))
    await becomes(() => page.locator('.report details[open]').count(), 0)
  })

  it('explains its words by the keyboard', async () => {
    await openAll()
    assert.deepEqual(await unexplained(page), [])
    for (const [word, { text, within }] of await explanations(page)) assert.ok(text.length > 11 && within, `${word}: ${text}`)
  })

  it('draws the condition of its finding first, names and missing values too', async () => {
    const names = () => page.getByRole('img', { name: /^Measured minus simulated/ }).evaluateAll((figures) => figures.map((f) => f.getAttribute('aria-label')))
    await becomes(async () => (await names()).map((n) => n.match(/over (.*?):/)[1]), ['Relative humidity (%)', 'Pressure (hPa)', 'Operator'])
    assert.match((await names())[0], /23 runs, 4 without a recorded value/)
    assert.equal(await page.locator('main b').count(), 0)
    const drawn = await page.locator('figure svg').evaluateAll((figures) => figures.map((f) => f.innerHTML).join(''))
    assert.doesNotMatch(drawn, /NaN|Infinity|undefined/)
    await page.getByText('Table of all rows').click()
    const cells = await csvEqualsTable('Rows of the file, before and after')
    assert.deepEqual(cells[1], ['2', 'Sand', '28.00', '28.80', '1.20', '28.40', '0.90', '-0.80', '1000', '', 'Aiko'])
  })

  it('greys what cannot be tested and says why', async () => {
    assert.deepEqual((await csvEqualsTable('Evidence for each cause')).slice(1), [
      ['Humidity', '+8.3', '93', 'Moisture', ''],
      ['Unknown cause, with pressure', '-0.8', '< 1', '', ''],
      ['Unknown cause, with nothing recorded', '+2.1', '2', '', ''],
      ['Vibration', '', '', '', 'vibration_rms_m_s2 was not recorded'],
    ])
    await page.getByText('Level 2 of 3: the simulator extended by it predicts better').waitFor()
  })

  it('shows effects, gain, what it would have found, and the next experiment', async () => {
    assert.deepEqual(await csvEqualsTable('Effect on each powder'), [['Powder', 'Relative humidity, from 32 to 70 % (°)'], ['Sand', '+0.1 [-0.5, 0.7]'], ['Sugar', '+3.3 [2.5, 4.1]'], ['On average', '+1.7 [1.1, 2.3]']])
    assert.deepEqual((await csvEqualsTable('Errors on rows left out of the fit'))[1], ['Days', '23', '1.61°', '1.19°', '+0.42°', '[0.21, 0.63]'])
    assert.equal((await csvEqualsTable('Other scores before and after')).length, 1 + 5)
    await page.getByText('It is accepted.').waitFor()
    assert.deepEqual((await csvEqualsTable('Smallest detectable effects'))[1], ['Humidity', '1.1', '80'])
    assert.deepEqual((await csvEqualsTable('Runs of the next experiment'))[0], ['Run', 'Powder', 'Relative humidity (%)'])
    await page.getByText('1 h 35 min').waitFor()
  })

  it('without a discrepancy claims no cause and leaves out what it has not', async () => {
    await show('nothing')
    await page.locator('main .badge', { hasText: 'No discrepancy shown' }).waitFor()
    await becomes(() => page.locator('main h2, main h3').allTextContents(), ['How well each cause explains the data', 'Before and after', 'Null check', 'Provenance', 'Request'])
  })

  for (const colorScheme of ['light', 'dark']) {
    it(`has no fault that axe finds, in the ${colorScheme} theme`, async () => {
      await page.emulateMedia({ colorScheme })
      await show('cause')
      await page.evaluate(() => document.fonts.ready)
      await picture(page, `investigation-${colorScheme}`)
      assert.deepEqual(await accessibilityFaults(page), [])
    })
  }

  it('fits a narrow window without scrolling sideways', async () => {
    await page.setViewportSize({ width: 400, height: 800 })
    await show('cause')
    assert.ok(await fits(page))
    await page.setViewportSize({ width: 1400, height: 900 })
    await page.unrouteAll()
  })

  it('kept to the strict content security policy and to this host', () => assert.deepEqual(chromium.complaints, []))
})
