/** Verdict, gauge, error and means of a dose use one number, the final reading, and say how sure it is. */
import assert from 'node:assert/strict'
import { after, before, describe, it } from 'node:test'
import { accessibilityFaults, becomes, csvOf, openBrowser, picture } from './browser.mjs'
import { startService } from './service.mjs'

let service, chromium, page

before(async () => {
  service = await startService()
  chromium = await openBrowser(service.url)
  page = await chromium.tab()
}, { timeout: 60_000 })

after(async () => {
  await chromium?.browser.close()
  await service?.stop()
})

const ID = '01930000-0000-7000-8000-00000000000'
/** Salt, 12 mg: the balance shows 11.6 mg, and 10.1 mg are in the vial. */
const SALT = {
  id: `${ID}1`, powder: 'salt', target_mg: 12, tolerance_lower_mg: 1, tolerance_upper_mg: 1, policy: 'p-1', parameter_set: 'ps-1', seed: 1, state: 'done', outcome: 'within',
  dispensed_mg: 10.1, reading_mg: 11.6, error_mg: -1.9, shakes: 7, seconds: 20, created_at: '2026-01-02T03:04:05Z', finished_at: '2026-01-02T03:05:05Z', bench: 'emulated',
}
const measured = (uncertainty_mg, proven) => ({ net_mg: 11.6, uncertainty_mg, proven, stable_by_balance: true, stable_by_window: true, devices: {} })
/** Broken off: an older service wrote a mass of nothing. */
const ABORTED = { ...SALT, id: `${ID}2`, powder: 'sand', state: 'aborted', outcome: 'aborted', dispensed_mg: 0, reading_mg: 0, error_mg: -12, error: 'the arm does not answer' }

async function show(weighing, ticks = []) {
  await page.unrouteAll()
  await page.route(`**/v1/weighings/${weighing.id}`, (route) => route.fulfill({ json: { weighing, ticks } }))
  await chromium.open(page, `weighings/${weighing.id}`)
  await page.locator('.verdict').waitFor()
}
async function list(...items) {
  await page.unrouteAll()
  await page.route(/\/v1\/weighings\?/, (route) => route.fulfill({ json: { items } }))
}
const gauge = () => page.locator('.verdict svg[role=img]')
const fact = (name) => page.locator('main dl div', { has: page.locator('dt', { hasText: name }) }).locator('dd').first()

describe('a dose of which the balance shows another mass than is in the vial', () => {
  it('is judged, drawn and told by the reading, with the true mass beside it', async () => {
    await show({ ...SALT, measured: measured(0.3, true) })
    await becomes(() => page.locator('.verdict .badge').textContent(), 'Within')
    await becomes(() => gauge().getAttribute('aria-label'), /^Error −0\.40 mg, uncertainty 0\.30 mg; accepted from −1\.00 to \+1\.00 mg$/)
    await becomes(() => fact('Error, reading').textContent(), /^−0\.40 mg ± 0\.30$/)
    await becomes(() => fact('True mass, in simulation').textContent(), /^10\.10 mg −1\.90 from the target$/)
    assert.deepEqual(await accessibilityFaults(page), [])
  })

  it('counts by its reading in the list and in the mean of the overview', async () => {
    await list(SALT, ABORTED)
    await chromium.open(page, 'weighings')
    const { rows } = await csvOf(page, 'Weighings')
    const column = (name) => rows.slice(1).map((cells) => cells[rows[0].indexOf(name)])
    assert.deepEqual([column('Reading (mg)'), column('Error (mg)'), column('True mass (mg)')], [['11.6', ''], ['-0.40', ''], ['10.10', '0.00']])
    await chromium.open(page, 'story')
    await page.getByText('Mean absolute error of these doses: 0.40 mg; within tolerance: 1 of 1').waitFor()
    await picture(page, 'overview-reading')
  })
})

describe('a dose that a person stopped', () => {
  it('is listed with its reading, and counts in no mean', async () => {
    await list(SALT, { ...SALT, id: `${ID}3`, powder: 'sugar', state: 'aborted', outcome: 'stopped', reading_mg: 2 })
    await chromium.open(page, 'weighings')
    const { rows } = await csvOf(page, 'Weighings')
    assert.equal(rows[2][rows[0].indexOf('Reading (mg)')], '2.0')
    await chromium.open(page, 'story')
    await page.getByText('Mean absolute error of these doses: 0.40 mg; within tolerance: 1 of 1').waitFor()
  })
})

describe('a dose within its tolerance by less than its uncertainty', () => {
  it('is not proven, and its uncertainty is drawn as an interval', async () => {
    await show({ ...SALT, measured: measured(0.9, false) })
    await becomes(() => page.locator('.verdict .badge').textContent(), 'Within, not proven')
    const [low, high] = await gauge().locator('.interval').evaluate((path) => { const { x, width } = path.getBBox(); return [x, x + width] })
    const band = await gauge().locator('.band').evaluate((rect) => { const { x, width } = rect.getBBox(); return [x, x + width] })
    // From −1.3 to +0.5 mg on a scale where the band goes from −1 to +1 mg.
    const mg = (pixel) => -1 + (2 * (pixel - band[0])) / (band[1] - band[0])
    assert.ok(Math.abs(mg(low) + 1.3) < 0.02 && Math.abs(mg(high) - 0.5) < 0.02, `${mg(low)} to ${mg(high)}`)
    await page.emulateMedia({ colorScheme: 'dark' })
    await picture(page, 'weighing-unproven-dark')
    assert.deepEqual(await accessibilityFaults(page), [])
    await page.emulateMedia({ colorScheme: 'light' })
    await picture(page, 'weighing-unproven')
  })

  it('is named so in the list and counted so in the overview', async () => {
    await list({ ...SALT, measured: measured(0.9, false) })
    await chromium.open(page, 'weighings')
    await page.getByRole('table', { name: 'Weighings' }).getByText('Within, not proven').waitFor()
    await chromium.open(page, 'story')
    await page.getByText('within tolerance: 1 of 1, of which 1 not proven').waitFor()
  })

  it('keeps the gauge readable where the uncertainty is many times the tolerance', async () => {
    await show({ ...SALT, measured: measured(29.9, false) })
    const [band, low, high] = await gauge().evaluate((svg) => {
      const { x, width } = svg.querySelector('.interval').getBBox()
      return [svg.querySelector('.band').getBBox().width, x, x + width]
    })
    assert.ok(band > 60 && low >= 0 && high <= 420, `band ${band}, interval ${low} to ${high}`)
  })
})

describe('a dose that was broken off', () => {
  it('shows no mass where there is no final reading', async () => {
    for (const weighing of [ABORTED, { ...ABORTED, dispensed_mg: null, reading_mg: null, error_mg: null }]) {
      await show(weighing, [{ step: 1, t_s: 1, reading: { mass_mg: 3, stable: false }, action: { incline_change_deg: 1, shake_mm: 1 }, pitch_deg: 10 }])
      await page.getByRole('group', { name: 'Balance', exact: true }).getByText('no reading').waitFor()
      await page.getByText('There is no final reading.').waitFor()
      await becomes(() => gauge().count(), 0)
      await becomes(() => fact('Error, reading').textContent(), '–')
    }
    await picture(page, 'weighing-aborted')
  })
})
