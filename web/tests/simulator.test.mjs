/** Versions of the simulator, in a real Chromium before a real `flip serve`: listed, compared, taken into use and rolled back. */
import assert from 'node:assert/strict'
import { after, before, describe, it } from 'node:test'
import { accessibilityFaults, becomes, csvAsShown, fits, openBrowser, picture, tableCells, unlock } from './browser.mjs'
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
const current = () => service.get('/v1/simulators/current')

/** The view's CSV is what its table shows. */
const csvEqualsTable = (caption) => csvAsShown(page, caption)

describe('simulators', () => {
  let version, report

  it('without a version are the base alone, and the page says where versions come from', async () => {
    await chromium.open(page, 'simulators')
    await page.getByText('No versions yet').waitFor()
    await page.getByText('no other version has been chosen').waitFor()
    await becomes(async () => (await csvEqualsTable('Versions of the simulator')).slice(1).map((cells) => cells[0]), ['Base simulator'])
    assert.equal(await page.getByRole('heading', { name: 'Side by side' }).count(), 0)
  })

  it('list the version of an investigation that won, as soon as it has', async () => {
    const job = await service.post('/v1/investigations', { measurements_csv: humidDays(), simulations: 99, budget_runs: 6, seed: 7 })
    await service.finished(job.id)
    report = (await service.get(`/v1/investigations/${job.id}`)).report
    version = (await service.get('/v1/simulators')).items[0]
    assert.equal(version.id, report.simulator_version.extended)
    await table('Versions of the simulator').getByRole('rowheader', { name: version.id }).waitFor()
    const rows = await csvEqualsTable('Versions of the simulator')
    assert.deepEqual(rows.slice(1).map((cells) => cells[0]), ['Base simulator', version.id])
    const { held_out: heldOut } = version.body.gain
    assert.deepEqual([rows[2][1], rows[2][2], rows[2][4], rows[2][5]], [version.base, version.created_at, version.body.verified ? 'yes' : 'not yet', version.body.sentence])
    assert.match(rows[2][3], new RegExp(`^\\+${(heldOut.rmse_before - heldOut.rmse_after).toFixed(2)} \\[`))
  })

  it('stand side by side: the base, and the newest version', async () => {
    const rows = await csvEqualsTable('Versions compared')
    const cells = Object.fromEntries(rows.map(([what, ...sides]) => [what, sides]))
    const { gain, causes } = version.body
    assert.match(rows[0][1], /^Base simulator$/)
    assert.match(rows[0][2], /^Humidity, sv-/)
    assert.deepEqual(cells['RMS error on days left out'], [`${gain.held_out.rmse_before.toFixed(2)}°`, `${gain.held_out.rmse_after.toFixed(2)}°`])
    assert.deepEqual(cells['Log score, nats per run (higher is better)'].map(Number), [gain.log_score.before, gain.log_score.after].map((x) => Number(x.toFixed(2))))
    assert.deepEqual(cells['Runs within their 90 % interval, % (ideal: 90)'].map(Number), [gain.coverage90.before, gain.coverage90.after].map((x) => Math.round(100 * x)))
    assert.deepEqual(cells['Runs left out'], [String(gain.held_out.n), String(gain.held_out.n)])
    const [effect] = causes[0].parameters
    const fitted = rows.find(([what]) => what.startsWith('Humidity: '))
    assert.equal(fitted[1], '')
    assert.ok(fitted[2].startsWith(Number(effect.value.toPrecision(3)).toString().slice(0, 3)), `${fitted[2]} is not ${effect.value}`)
  })

  it('draw every powder over the condition that was found, from the stored numbers', async () => {
    const names = () => page.getByRole('img', { name: /angle of repose over/ }).evaluateAll((figures) => figures.map((f) => f.getAttribute('aria-label')))
    await becomes(async () => (await names()).map((name) => name.split(':')[0]), ['Sand', 'Sugar', 'Salt'])
    for (const name of await names()) assert.match(name, /over Relative humidity \(%\), measured, by Base simulator and by Humidity, sv-[0-9a-f]{16}; 24 runs, 0 without a recorded value/)
    const drawn = await page.locator('figure svg').evaluateAll((figures) => figures.map((f) => f.innerHTML).join(''))
    assert.doesNotMatch(drawn, /NaN|Infinity|undefined/)
    await page.getByText('Table of predicted angles').click()
    const rows = await csvEqualsTable('Predicted angles')
    assert.deepEqual(rows.slice(1).map((cells) => cells.slice(-2)), report.rows.map((row) => [row.before_deg.toFixed(2), row.after_deg.toFixed(2)]))
    await page.getByLabel('Over', { exact: true }).selectOption({ label: 'Temperature (°C)' })
    await page.getByRole('img', { name: /Salt: angle of repose over Temperature/ }).waitFor()
    await page.waitForURL(/over=temperature_c/)
  })

  it('ask for a token before one is taken into use', async () => {
    await page.getByRole('button', { name: `Use ${version.id}` }).click()
    await page.getByRole('dialog').getByText('flip token create --role operator').waitFor()
    await page.keyboard.press('Escape')
    assert.equal((await current()).simulator, 'base')
  })

  it('are taken into use and rolled back from the keyboard', async () => {
    await unlock(page, service.token)
    await page.getByRole('button', { name: `Use ${version.id}` }).focus()
    await page.keyboard.press('Enter')
    // Adopted knowingly: the gain, what it does not cover, and a reason.
    const dialog = page.getByRole('dialog', { name: /^Use Humidity, sv-/ })
    await dialog.getByText(/Error reduced by/).waitFor()
    await dialog.getByText(/It is known only for relative humidity \(%\) from \d/).waitFor()
    assert.deepEqual(await accessibilityFaults(page), [])
    await picture(page, 'simulator-adopt')
    await dialog.getByRole('button', { name: 'Use it' }).click()
    assert.equal((await current()).simulator, 'base', 'not without a reason')
    await dialog.getByLabel('Reason, for the record').fill('It predicts humid days')
    await page.keyboard.press('Tab')
    await page.keyboard.press('Enter')
    await page.getByRole('status').getByText(/^Humidity, sv-.* is now in use\.$/).waitFor()
    const used = await current()
    assert.deepEqual([used.simulator, used.before, used.reason], [version.id, 'base', 'It predicts humid days'])
    await page.getByText('Reason: It predicts humid days').waitFor()
    // What is in use cannot be chosen again.
    await becomes(() => page.getByRole('button', { name: `Use ${version.id}` }).count(), 0)
    await page.getByRole('button', { name: 'Use the base simulator' }).waitFor()

    await page.getByRole('button', { name: 'Go back to Base simulator' }).focus()
    await page.keyboard.press('Space')
    await page.getByLabel('Reason, for the record').fill('Back, for a comparison')
    await page.getByRole('button', { name: 'Use it' }).click()
    await page.getByRole('status').getByText('Base simulator is now in use.').waitFor()
    const back = await current()
    assert.deepEqual([back.simulator, back.before], ['base', version.id])
    assert.deepEqual((await service.get('/v1/simulators')).items, [version], 'the version is as it was')
  })

  it('show what somebody else chose, without a reload', async () => {
    const answer = await fetch(`${service.url}/v1/simulators/current`, { method: 'PUT', headers: { authorization: `Bearer ${service.token}`, 'content-type': 'application/json' }, body: JSON.stringify({ simulator: version.id }) })
    assert.equal(answer.status, 200)
    await page.locator('.current strong', { hasText: version.id }).waitFor()
    // docs/pictures/simulators.png is this.
    await chromium.open(page, 'simulators')
    await page.getByRole('img', { name: /Salt: angle of repose over Relative humidity/ }).waitFor()
    await page.evaluate(() => document.fonts.ready)
    await picture(page, 'simulators-real')
  })

  it('are chosen in every form that computes: first the one in use, with its conditions', async () => {
    await chromium.open(page, 'trainings?new=training')
    const simulator = page.getByLabel('Simulator', { exact: true })
    await page.getByRole('combobox', { name: 'Simulator' }).waitFor()
    await becomes(() => simulator.inputValue(), version.id)
    await page.getByLabel('Relative humidity (%)').fill('99')
    const [request] = await Promise.all([page.waitForRequest((it) => it.method() === 'POST' && it.url().endsWith('/v1/trainings')), page.getByRole('button', { name: 'Start the training' }).click()])
    assert.deepEqual([request.postDataJSON().simulator, request.postDataJSON().conditions], [version.id, { relative_humidity_pct: 99 }])
    // Its powders are not calibrated with that version: the page says so, and where to.
    await page.getByRole('alert').getByText(/has no calibration yet/).waitFor()
    await simulator.selectOption('base')
    await becomes(() => page.getByLabel('Relative humidity (%)').count(), 0)
    await chromium.open(page, 'weighings?new=dose')
    await page.getByLabel('Simulator', { exact: true }).waitFor()
    await becomes(() => page.getByLabel('Simulator', { exact: true }).inputValue(), version.id)
    const [policy] = (await service.get('/v1/policies')).items
    await chromium.open(page, `policies/${policy.id}?new=evaluation`)
    await page.getByLabel('Simulator', { exact: true }).waitFor()
    await page.getByLabel('Targets (mg)').fill('10 mg; abc')
    await page.getByRole('group', { name: 'Powders' }).waitFor()
    await page.getByLabel('Simulator', { exact: true }).selectOption('base')
    await page.getByRole('button', { name: 'Start the evaluation' }).click()
    await page.getByText(/must be masses in mg, as in 15, 20, got abc/).first().waitFor()
    assert.deepEqual(await accessibilityFaults(page), [])
  })

  it('are where an investigation says that it made one', async () => {
    await chromium.open(page, `investigations/${version.investigation}`)
    await page.getByRole('link', { name: version.id }).click()
    await page.getByRole('heading', { name: 'Simulators', level: 1 }).waitFor()
    await table('Versions compared').getByRole('columnheader', { name: version.id }).waitFor()
  })
})

describe('two versions of different campaigns', () => {
  // Documents made up in the form of the service's, so that parts which no campaign of these tests has are seen, and parts that the page does not know.
  const rows = (shift) => Array.from({ length: 12 }, (_, k) => ({ row: k + 2, powder: ['sand', 'salt'][k % 2], measured_deg: 30 + k / 3, before_deg: 31 + shift, before_sd_deg: 1, after_deg: k === 3 ? null : 30.2 + shift + k / 3, after_sd_deg: 0.8 }))
  const gain = (after) => ({ held_out: { rmse_before: 1.61, rmse_after: after, ci95: [0.21, 0.63], unit: 'deg', n: 23 }, by_powder: null, by_range: null, log_score: { before: -1.91, after: -1.62, ci95: [0.1, 0.4] }, coverage90: { before: 0.78, after: 0.9 }, weighing_error_mg: { before: 1.42, after: 0.97, sham: 1.38, oracle: null, ci95: [0.19, 0.71] }, accepted: true })
  const cause = (mechanism, value) => ({ mechanism, family: '', inclusion_probability: 0.93, confidence_level: 2, parameters: [{ name: 'effect_5_95', value, ci95: [value - 1, value + 1], unit: 'deg' }], powders: [] })
  const version = (id, investigation, body) => ({ id, base: 'pbd-3', investigation, body, created_at: '2026-01-02T03:04:05Z' })
  const curve = (covariate, levels = []) => ({ covariate, levels, at: Array.from({ length: 12 }, (_, k) => (k === 5 ? null : levels.length ? k % 2 : 30 + 3 * k)), course: [] })
  const reportOf = (shift, covariate, curves) => ({ rows: rows(shift), curves, findings: [{ covariate, by_powder: [], effect: 1, ci95: [0, 2], unit: 'deg', span: '', channel: 'repose', powders: [] }], unexplained: null })
  const [first, second] = ['sv-1111111111111111', 'sv-2222222222222222']
  const items = [
    version(second, 'job-2', { sentence: 'Rest makes salt pile <b>steeper</b>.', causes: [cause('rest_time', 3.1), cause('operator', -1)], unexplained: null, gain: gain(1.31), verified: true, extensions: { humidity: { amplitude: 0.3, powders: ['salt'] } }, lineage: ['pbd-3', first] }),
    version(first, 'job-1', { sentence: 'Pressure does it.', causes: [], unexplained: { covariate: 'pressure_hpa', law: 'a step at 1010', form_class: 'threshold' }, gain: { ...gain(1.4), weighing_error_mg: null }, verified: false }),
    version('sv-3333333333333333', 'job-3', { causes: 'none', gain: null }),
  ]

  async function show(query = `?a=${first}&b=${second}`) {
    await page.unrouteAll()
    await page.route('**/v1/simulators?*', (route) => route.fulfill({ json: { items, next: null } }))
    await page.route('**/v1/simulators/current', (route) => route.fulfill({ json: { simulator: second, base: 'pbd-3', chosen_at: '2026-01-03T00:00:00Z', before: first } }))
    await page.route('**/v1/investigations/job-1', (route) => route.fulfill({ json: { report: reportOf(0, 'pressure_hpa', [curve('pressure_hpa'), curve('operator', ['Aiko', 'Bo'])]) } }))
    await page.route('**/v1/investigations/job-2', (route) => route.fulfill({ json: { report: reportOf(2, 'rest_min', [curve('rest_min'), curve('operator', ['Bo', 'Cid'])]) } }))
    await page.route('**/v1/investigations/job-3', (route) => route.fulfill({ json: { report: null } }))
    await chromium.open(page, `simulators${query}`)
    await table('Versions compared').waitFor()
  }

  it('are each compared with the base, and the page says that their errors are of different days', async () => {
    await show()
    await page.getByText('The two come from different campaigns').waitFor()
    const cells = Object.fromEntries((await csvEqualsTable('Versions compared')).map(([what, ...sides]) => [what, sides]))
    assert.deepEqual(cells.Compared, ['Unknown cause, with pressure, sv-1111111111111111', 'Consolidation at rest and difference between operators, sv-2222222222222222'])
    assert.deepEqual(cells['Consolidation at rest'], ['', '93 % probable, level 2 of 3'])
    assert.deepEqual(cells['Consolidation at rest: change from the 5th to the 95th percentile [95 %]'], ['', '3.10° [2.10, 4.10]'])
    assert.deepEqual(cells['Law of an unknown cause'], ['Pressure (hPa): a step at 1010', ''])
    assert.deepEqual(cells['Confirmed by simulations'], ['not yet', 'yes'])
    assert.deepEqual(cells['The base on the same days'], ['1.61°', '1.61°'])
    assert.deepEqual(cells['Mean weighing error, mg'], ['', '0.97'])
  })

  it('show parts that the page does not know as they are', async () => {
    const cells = Object.fromEntries((await tableCells(table('Versions compared'))).map(([what, ...sides]) => [what, sides]))
    // The causes say what is extended, and by how much.
    assert.equal(cells.Extensions, undefined)
    assert.deepEqual(cells.Lineage, ['', 'pbd-3; sv-1111111111111111'])
    assert.equal(await page.locator('main b').count(), 0)
  })

  it('are drawn over what each campaign recorded, names of both beside each other', async () => {
    await page.getByRole('img', { name: /Sand: angle of repose over Pressure/ }).waitFor()
    await page.getByText('difference between operators, sv-2222222222222222: no predictions over Pressure (hPa)').waitFor()
    await page.getByLabel('Over', { exact: true }).selectOption({ label: 'Operator' })
    const figure = page.getByRole('img', { name: /Salt: angle of repose over Operator.*12 runs|Salt: angle of repose over Operator.*10 runs/ })
    await becomes(() => figure.textContent(), /Aiko.*Bo.*Cid/s)
    assert.doesNotMatch(await figure.innerHTML(), /NaN|Infinity|undefined/)
  })

  it('of which one says nothing stand all the same', async () => {
    await show(`?a=base&b=sv-3333333333333333`)
    const cells = Object.fromEntries((await csvEqualsTable('Versions compared')).map(([what, ...sides]) => [what, sides]))
    assert.deepEqual(cells['RMS error on days left out'], ['', ''])
    await page.getByText('No description.').waitFor()
    await page.getByLabel('Second version').selectOption({ label: 'Base simulator' })
    await page.getByText('Choose two different versions.').waitFor()
  })

  for (const colorScheme of ['light', 'dark']) {
    it(`have no fault that axe finds, in the ${colorScheme} theme`, async () => {
      await page.emulateMedia({ colorScheme })
      await show()
      await page.evaluate(() => document.fonts.ready)
      await picture(page, `simulators-${colorScheme}`)
      assert.deepEqual(await accessibilityFaults(page), [])
    })
  }

  it('fit a narrow window without scrolling sideways', async () => {
    await page.emulateMedia({ colorScheme: 'light' })
    await page.setViewportSize({ width: 400, height: 800 })
    await show()
    await picture(page, 'simulators-narrow')
    await becomes(() => page.evaluate(() => [...document.querySelectorAll('main *')].filter((e) => e.getBoundingClientRect().right > innerWidth && !e.closest('.scroll')).map((e) => e.outerHTML.slice(0, 120))), [])
    assert.ok(await fits(page))
    await page.setViewportSize({ width: 1400, height: 900 })
    await page.unrouteAll()
  })

  it('kept to the strict content security policy and to this host', () => assert.deepEqual(chromium.complaints, []))
})
