/** Investigations, in a real Chromium before a real `flip serve`: from a file of angles to a report, and everything that a report may hold. */
import assert from 'node:assert/strict'
import { readFileSync } from 'node:fs'
import { after, before, describe, it } from 'node:test'
import { accessibilityFaults, csvOf, openBrowser, picture, tableCells, unlock } from './browser.mjs'
import { humidDays } from './campaign.mjs'
import { startService } from './service.mjs'

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

const table = (caption) => page.getByRole('table', { name: caption, exact: true })

/** The view's CSV is what its table shows. */
async function csvEqualsTable(caption) {
  const { rows } = await csvOf(page, caption)
  assert.deepEqual(rows, await tableCells(table(caption)))
  return rows
}

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
    await upload('powder,repose_deg,relative_humidity_pct\nsand,28,40\nsand,280,40\n')
    await start()
    await page.getByRole('alert').getByText(/row\[3\]\.repose_deg/).waitFor()
    assert.equal((await service.get('/v1/investigations')).items.length, 0)
  })

  it('is started with a file and watched until its report is there', async () => {
    await upload(humidDays())
    await page.getByLabel('Seed').fill('7')
    await page.getByLabel('Campaigns without an effect').fill('199')
    await start()
    await page.getByRole('heading', { name: 'Investigation', level: 1, exact: true }).waitFor()
    await page.locator('main .badge', { hasText: 'Succeeded' }).waitFor({ timeout: 240_000 })
    id = new URL(page.url()).hash.split('/').at(-1)
    found = await service.get(`/v1/investigations/${id}`)
    assert.deepEqual([found.seed, found.simulations], [7, 199])
    await page.getByText(found.report.sentence, { exact: true }).waitFor()
    await page.getByText('chance of evidence this strong if nothing is wrong').waitFor()
    await picture(page, 'investigation-real')
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
    await upload(humidDays())
    await page.getByLabel('Campaigns without an effect').fill('9999')
    await start()
    await page.getByRole('button', { name: 'Cancel' }).click()
    await page.locator('main .badge', { hasText: 'Cancelled' }).waitFor({ timeout: 120_000 })
  })
})

describe('a report', () => {
  // Which parts a report has is up to its data: these documents are made up, in the form of report.json, so that every part is seen.
  const ID = '0193a000-0000-7000-8000-0000000000aa'
  const rows = Array.from({ length: 24 }, (_, k) => ({
    row: k + 2,
    powder: ['sand', 'sugar', 'salt'][k % 3],
    measured_deg: k === 4 ? null : [28, 31, 36][k % 3] + (k % 5) * 0.4,
    before_deg: [28.8, 31.8, 36.8][k % 3],
    before_sd_deg: 1.2,
    after_deg: [28.4, 31.4, 36.4][k % 3] + (k % 5) * 0.2,
    after_sd_deg: 0.9,
  }))
  const heldOut = { rmse_before: 1.61, rmse_after: 1.19, ci95: [0.21, 0.63], unit: 'deg', n: 23 }
  const cause = (mechanism, family, inclusion_probability) => ({ mechanism, family, inclusion_probability, confidence_level: 1, parameters: [], powders: [] })
  const base = {
    schema_version: 1,
    sentence: 'Humidity makes sugar pile steeper than the simulation predicts.',
    verdict: 'cause',
    p_value: 0.002,
    findings: [
      {
        channel: 'repose', covariate: 'relative_humidity_pct', powders: ['sugar'], effect: 1.7, ci95: [1.1, 2.3], unit: 'deg', span: 'from 32 to 70 % relative humidity',
        by_powder: [{ powder: 'sand', effect: 0.1, ci95: [-0.5, 0.7] }, { powder: 'sugar', effect: 3.3, ci95: [2.5, 4.1] }],
      },
    ],
    causes: [{ ...cause('humidity', 'moisture', 0.934), confidence_level: 2, parameters: [{ name: 'liquid_bridges', value: 0.312, ci95: [0.21, 0.41], unit: '' }], powders: ['sugar'] }, cause('container_age', 'ageing', 0.05)],
    ambiguous_between: [],
    unexplained: null,
    suggested_experiment: { what: 'Dry the sugar for two hours and measure it again.', runs: [{ powder: 'sugar', relative_humidity_pct: '30' }, { powder: 'sugar', relative_humidity_pct: '70' }], minutes: 95, chance_of_resolution: 0.91, expected_posterior: 0.95 },
    simulator_version: { base: 'base-1', extended: 'base-1+humidity', verified: true },
    gain: { held_out: heldOut, by_powder: { ...heldOut, rmse_after: 1.33, ci95: [0.05, 0.51] }, by_range: null, log_score: { before: -1.91, after: -1.62, ci95: [0.12, 0.46] }, coverage90: { before: 0.78, after: 0.9 }, weighing_error_mg: { before: 1.42, after: 0.97, sham: 1.38, oracle: 0.88, ci95: [0.19, 0.71] }, accepted: true },
    minimum_detectable: [{ mechanism: 'humidity', effect_deg: 1.1, power: 0.8 }],
    blind_spots: ['A constant error of all angles of a powder cannot be seen.'],
    evidence: [
      { cause: 'humidity', family: 'moisture', log10_evidence: 8.3, inclusion_probability: 0.934 },
      { cause: 'unknown: pressure_hpa', family: null, log10_evidence: -0.8, inclusion_probability: 0.004 },
      { cause: 'unrecorded', family: null, log10_evidence: 2.1, inclusion_probability: 0.02 },
    ],
    untestable: [{ mechanism: 'vibration', reason: 'vibration_rms_m_s2 was not recorded' }],
    null_check: { campaigns: 499, statistic: 16.7, threshold95: 3.2 },
    rows,
    curves: [
      { covariate: 'pressure_hpa', levels: [], at: rows.map((_, k) => 1000 + k), course: [[1000, 0, 2], [1023, 0.1, 2]] },
      { covariate: 'relative_humidity_pct', levels: [], at: rows.map((_, k) => (k % 7 === 0 ? null : 30 + 2 * (k % 20))), course: [[30, -0.8, 2], [70, 0.9, 2]] },
      { covariate: 'operator', levels: ['Aiko', '<b>Bo</b>'], at: rows.map((_, k) => k % 2), course: [[0, 0, 2], [1, 0.1, 2]] },
    ],
    simulator_runs: 168,
    wall_s: 2640,
  }

  async function show(report) {
    const job = { id: ID, kind: 'investigation', state: 'succeeded', progress: { fraction: 1, message: '' }, attempts: 1, cancelling: false, created_at: '2026-01-02T03:04:05Z', started_at: '2026-01-02T03:04:06Z', finished_at: '2026-01-02T03:48:06Z', error: null }
    await page.unrouteAll()
    await page.route(`**/v1/investigations/${ID}`, (route) => route.fulfill({ json: { job, powders: ['sand', 'sugar', 'salt'], runs: 23, sessions: 8, covariates: report.curves.map((c) => c.covariate), simulations: 499, seed: 1, simulator: 'base-1', verdict: report.verdict, p_value: report.p_value, sentence: report.sentence, report } }))
    await chromium.open(page, `investigations/${ID}`)
    await page.getByText(report.sentence, { exact: true }).waitFor()
  }

  it('begins with its sentence, verdict and p', async () => {
    await show(base)
    const first = page.locator('main .sheet').first()
    assert.match(await first.textContent(), /^Humidity makes sugar .*Cause named.*p = 0\.002: chance of evidence this strong if nothing is wrong\. It is the smallest that 499 simulated campaigns can show\./)
  })

  it('draws the condition of its finding first, names and missing values too', async () => {
    const names = await page.getByRole('img', { name: /^Measured minus simulated/ }).evaluateAll((figures) => figures.map((f) => f.getAttribute('aria-label')))
    assert.deepEqual(names.map((n) => n.match(/over (.*?):/)[1]), ['Relative humidity (%)', 'Pressure (hPa)', 'Operator'])
    assert.match(names[0], /23 runs, 4 without a recorded value/)
    assert.equal(await page.locator('main b').count(), 0)
    const drawn = await page.locator('figure svg').evaluateAll((figures) => figures.map((f) => f.innerHTML).join(''))
    assert.doesNotMatch(drawn, /NaN|Infinity|undefined/)
    await page.getByText('Table of all rows').click()
    const cells = await csvEqualsTable('Rows of the file, before and after')
    assert.deepEqual(cells[1], ['2', 'Sand', '28.00', '28.80', '1.20', '28.40', '0.90', '-0.80', '', '1000', 'Aiko'])
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
    await show({ ...base, sentence: 'Nothing is wrong that these runs could show.', verdict: 'no_discrepancy', p_value: 0.43, findings: [], gain: null, suggested_experiment: null, curves: [], minimum_detectable: [], blind_spots: [] })
    await page.locator('main .badge', { hasText: 'No discrepancy shown' }).waitFor()
    const headings = await page.locator('main h2, main h3').allTextContents()
    assert.deepEqual(headings, ['How well each cause explains the data', 'Before and after', 'Null check', 'Provenance'])
  })

  it('that cannot tell two causes apart, or knows none, says so', async () => {
    await show({ ...base, sentence: 'Humidity or ageing.', verdict: 'ambiguous', ambiguous_between: ['humidity', 'container_age'] })
    await page.getByText('this campaign cannot distinguish between humidity and ageing since opening. The experiment below would be the most informative.').waitFor()
    await show({ ...base, sentence: 'Angles rise with pressure.', verdict: 'unexplained', unexplained: { covariate: 'pressure_hpa', law: 'angle rises by 0.12° per hPa', form_class: 'linear' } })
    await page.getByText('It depends on pressure. Its law (a straight line): angle rises by 0.12° per hPa.').waitFor()
  })

  for (const colorScheme of ['light', 'dark']) {
    it(`has no fault that axe finds, in the ${colorScheme} theme`, async () => {
      await page.emulateMedia({ colorScheme })
      await show(base)
      await page.evaluate(() => document.fonts.ready)
      await picture(page, `investigation-${colorScheme}`)
      assert.deepEqual(await accessibilityFaults(page), [])
    })
  }

  it('fits a narrow window without scrolling sideways', async () => {
    await page.setViewportSize({ width: 400, height: 800 })
    await show(base)
    assert.ok(!(await page.evaluate(() => document.documentElement.scrollWidth > innerWidth)))
    await page.setViewportSize({ width: 1400, height: 900 })
    await page.unrouteAll()
  })

  it('kept to the strict content security policy and to this host', () => assert.deepEqual(chromium.complaints, []))
})
