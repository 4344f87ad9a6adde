/** What is found and foretold: records and doses by filters in the address, how long a calibration takes, how steep its heaps are, and measurements from a file. */
import assert from 'node:assert/strict'
import { after, before, describe, it } from 'node:test'
import { accessibilityFaults, becomes, csvOf, fits, openBrowser, openPanel, picture, unlock } from './browser.mjs'
import { startService } from './service.mjs'

let service, chromium, page, calibration
const WIDTHS = [1440, 1280, 390]

before(async () => {
  service = await startService()
  calibration = (await service.post('/v1/calibrations', { powder: 'sand', method: 'sequential', sets: 2, tolerance_deg: 5, trials_max: 60, particles: 400 })).id
  await service.finished(calibration)
  const dose = { powder: 'sand', target: { value: 12, unit: 'mg' }, tolerance: { lower: 1, upper: 1, unit: 'mg' }, asked: { operator: 'Ada' } }
  const { id } = await service.post('/v1/weighings', dose, { 'idempotency-key': 'found' })
  while (!(await service.get(`/v1/weighings/${id}`)).weighing.outcome) await new Promise((go) => setTimeout(go, 200))
  await service.put(`/v1/labels/weighing/${id}`, { name: 'Reference dose' })
  chromium = await openBrowser(service.url)
  page = await chromium.tab()
}, { timeout: 900_000 })

after(async () => {
  await chromium?.browser.close()
  await service?.stop()
})

/** What the address asks for by these keys. */
const asked = (...keys) => {
  const address = new URLSearchParams(page.url().split('?')[1])
  return keys.map((key) => address.get(key))
}
/** A day of the browser's, so many days ago. */
const day = (back) => page.evaluate((days) => new Date(Date.now() - days * 864e5).toLocaleDateString('sv'), back)

describe('the record', () => {
  const filters = () => page.getByRole('search', { name: 'Records' })
  const told = async (text) => filters().getByRole('status').getByText(text).waitFor()

  it('is found by kind, person, time and words, which are in the address', async () => {
    await chromium.open(page, 'bench')
    const { total } = await service.get('/v1/audit')
    await told(/^\S+ in all$/)
    await filters().getByLabel('Kind').selectOption('Intent')
    await told('1 match')
    const answer = page.waitForResponse(/\/v1\/audit\?.*person=ada/)
    await filters().getByRole('textbox', { name: 'Person' }).fill('ada')
    await filters().getByRole('textbox', { name: 'Person' }).press('Tab')
    await answer
    await told('1 match')
    await becomes(() => asked('kind', 'person'), ['intent', 'ada'])
    const { rows } = await csvOf(page, 'Records')
    assert.deepEqual([rows.length, rows[1][2]], [2, 'Intent'])
    const file = page.getByRole('link', { name: 'What matches (CSV)' })
    const text = await (await fetch(service.url + (await file.getAttribute('href')))).text()
    assert.equal(text.trim().split('\n').length, 2)
    await page.reload()
    await told('1 match')
    await filters().getByRole('button', { name: 'Show all' }).click()
    await told(`${total} in all`)
    await filters().getByRole('searchbox', { name: 'Search' }).fill('dosing')
    await filters().getByRole('searchbox', { name: 'Search' }).press('Enter')
    const words = await service.get('/v1/audit?q=dosing')
    assert.ok(words.total > 0)
    await told(`${words.total} match`)
  })

  it('of today is one press away', async () => {
    await chromium.open(page, 'bench')
    const today = filters().getByRole('button', { name: 'Today' })
    await today.press('Enter')
    await becomes(() => asked('since', 'until'), [await day(0), await day(0)])
    await becomes(() => today.getAttribute('aria-pressed'), 'true')
    await told(/ match$/)
    await today.press('Enter')
    await becomes(() => asked('since'), [null])
  })

  for (const width of WIDTHS) {
    it(`fits a window of ${width} px, and axe finds nothing`, async () => {
      await page.setViewportSize({ width, height: 900 })
      await chromium.open(page, 'bench?kind=person')
      await told(/ match$/)
      assert.ok(await fits(page))
      assert.deepEqual(await accessibilityFaults(page), [])
      await picture(page, `record-${width}`)
    })
  }
})

describe('doses', () => {
  const told = async (text) => page.locator('.filters').getByRole('status').getByText(text).waitFor()

  it('outside their tolerance, and of the last days, are one press away', async () => {
    await page.setViewportSize({ width: 1440, height: 900 })
    await chromium.open(page, 'weighings')
    await page.getByRole('button', { name: 'Outside tolerance' }).press('Enter')
    await becomes(() => asked('outcome'), ['outside'])
    const { total } = await service.get('/v1/weighings?outside=true')
    await told(`${total} match`)
    await page.getByRole('button', { name: 'Outside tolerance' }).press('Enter')
    await page.getByRole('button', { name: 'Last 7 days' }).press('Enter')
    // The days themselves are in the address: tomorrow the link shows the same doses.
    await becomes(() => asked('since', 'until', 'outcome'), [await day(6), await day(0), null])
    await told('1 match')
    await picture(page, 'weighings-spans')
  })

  it('are found by the name that they were given', async () => {
    await chromium.open(page, 'weighings?q=reference')
    await told('1 match')
    await chromium.open(page, 'weighings?q=nobody')
    await told('0 match')
  })

  for (const width of WIDTHS) {
    it(`fit a window of ${width} px, and axe finds nothing`, async () => {
      await page.setViewportSize({ width, height: 900 })
      await chromium.open(page, 'weighings')
      await told('1 in all')
      assert.ok(await fits(page))
      assert.deepEqual(await accessibilityFaults(page), [])
    })
  }
})

describe('a calibration', () => {
  it('says in a sentence whether its heaps are as steep as the measured one', async () => {
    await page.setViewportSize({ width: 1440, height: 900 })
    const { steepness: it, target } = await service.get(`/v1/calibrations/${calibration}`)
    const verdict = it.agrees ? 'The simulated heaps are as steep as the measured one' : `The simulated heaps are ${it.difference_deg > 0 ? 'steeper' : 'less steep'} than the measured one`
    for (const view of [`calibrations/${calibration}`, 'powders/sand']) {
      await chromium.open(page, view)
      const said = page.getByRole('status').filter({ hasText: verdict })
      await said.getByText(`${it.simulated_deg.toFixed(2)}° against ${target.repose_deg.toFixed(2)}°`).waitFor()
      await said.getByText(`uncertainty of ${it.uncertainty_deg.toFixed(2)}° (k = 2)`).waitFor()
    }
  })

  it('is told before it begins how long earlier ones took, and nothing where there are none', async () => {
    await chromium.open(page, 'powders/sand')
    await openPanel(page, 'Calibrate')
    await page.getByText(/^None has ended here yet\. The first one simulates 240 heaps/).waitFor()
    await page.getByLabel('Search method').selectOption('sequential')
    await page.getByText(/^The one earlier one took [\d].* here$/).waitFor()
    const [times] = await service.get('/v1/jobs/times')
    assert.deepEqual([times.kind, times.method, times.n], ['calibration', 'sequential', 1])
  })

  it('that runs is not denied: neither on the powder nor where a dose is refused', async () => {
    const { id } = await service.post('/v1/calibrations', { powder: 'salt', method: 'paper', sets: 50, trials_max: 20000 })
    await chromium.open(page, 'powders/salt')
    await page.getByRole('link', { name: 'A calibration is running' }).waitFor()
    assert.equal(await page.getByText('No calibration yet').count(), 0)
    await unlock(page, service.token)
    await chromium.open(page, 'weighings?powder=salt&new=dose')
    const form = page.getByRole('form', { name: /Weigh/ }).first()
    await form.getByLabel(/Target/).first().fill('10')
    await form.getByRole('button', { name: /^Weigh/ }).click()
    await page.getByText('Salt has no calibration yet: one is running.').waitFor()
    const again = await service.post('/v1/calibrations', { powder: 'sugar', method: 'sequential', sets: 2, tolerance_deg: 5, trials_max: 60, particles: 400 })
    await chromium.open(page, 'jobs')
    await page.getByText(/^1 waits, about [\d]+ s in all\.$/).waitFor()
    await page.getByRole('row', { name: /Calibration/ }).filter({ hasText: 'Running' }).getByText(/time left not known yet|left$|longer than expected/).waitFor()
    await picture(page, 'jobs-queue')
    for (const job of [again.id, id]) await service.post(`/v1/jobs/${job}/cancel`)
  })
})

describe('measurements of a file', () => {
  it('are added from the list of powders, with their days', async () => {
    await chromium.open(page, 'powders')
    await openPanel(page, 'Import measurements')
    const form = page.locator('form', { hasText: 'Powders not yet registered' })
    await form.getByLabel('File (CSV)').setInputFiles({ name: 'repeats.csv', mimeType: 'text/csv', buffer: Buffer.from('powder,method,repose_deg,date\nsugar,manual,33,2026-02-03\nsugar,manual,35,2026-02-03\nsugar,manual,36,2026-02-04\n') })
    await form.getByRole('button', { name: "Add the file's measurements" }).click()
    await form.getByText('2 measurements and 0 observations added').waitFor()
    await chromium.open(page, 'powders/sugar')
    const { rows } = await csvOf(page, 'Measurements')
    const [on, n] = ['Measured on', 'n'].map((name) => rows[0].indexOf(name))
    assert.deepEqual(rows.slice(-2).map((row) => [row[on], row[n]]), [['2026-02-03', '2'], ['2026-02-04', '1']])
    assert.deepEqual(chromium.complaints, [])
  })
})
