/** Measurements as files, calibrations as files and beside each other, and the posterior, in a real Chromium before a real `flip serve`. */
import assert from 'node:assert/strict'
import { readFileSync } from 'node:fs'
import { after, before, describe, it } from 'node:test'
import { accessibilityFaults, becomes, csvOf, fits, openBrowser, openPanel, picture, tableCells, unlock } from './browser.mjs'
import { startService } from './service.mjs'

let service, chromium, page
const made = {}

before(async () => {
  service = await startService()
  // Few grains make quick heaps, but only flat ones: sand and sugar.
  for (const powder of ['sand', 'sugar']) {
    made[powder] = await service.post('/v1/calibrations', { powder, method: 'sequential', sets: 2, tolerance_deg: 5, trials_max: 60, particles: 400 })
  }
  for (const powder of ['sand', 'sugar']) await service.finished(made[powder].id)
  chromium = await openBrowser(service.url)
  page = await chromium.tab()
}, { timeout: 900_000 })

after(async () => {
  await chromium?.browser.close()
  await service?.stop()
})

const table = (caption) => page.getByRole('table', { name: caption, exact: true })

/** Presses a button and reads the file it gives. */
async function fileOf(button) {
  const [file] = await Promise.all([page.waitForEvent('download'), page.getByRole('button', { name: button, exact: true }).click()])
  return { name: file.suggestedFilename(), text: readFileSync(await file.path(), 'utf8') }
}

describe('a file of measurements', () => {
  const upload = (text) => page.getByLabel('File (CSV)').setInputFiles({ name: 'bench.csv', mimeType: 'text/csv', buffer: Buffer.from(text) })
  const add = () => page.getByRole('button', { name: "Add the file's measurements" }).click()

  it('is refused by row and column, and nothing of it is stored', async () => {
    await chromium.open(page, 'powders/salt')
    await unlock(page, service.token)
    await openPanel(page, 'Import measurements')
    await upload('powder,repose_deg\nsalt,36\nsalt,360\n')
    await add()
    await page.getByRole('alert').getByText('row[3].repose_deg').waitFor()
    await upload('powder,repose_deg\nsalt,36\nflour,47\n')
    await add()
    await page.getByRole('alert').getByText('row[3].powder').waitFor()
    assert.equal((await service.get('/v1/powders/salt')).measurements.length, 2)
  })

  it('adds measurements and observations, which the view then shows', async () => {
    await page.getByLabel('Powders not yet registered').selectOption('Register them')
    await upload('powder,repose_deg,height_mm,base_diameter_mm,drained_deg,source\nsalt,36,,,40,"bench, today"\nsalt,38,,,42,"bench, today"\nflour,,20,40,,\n')
    await add()
    await page.getByRole('status').getByText('2 measurements and 1 observation added; registered: flour.').waitFor()
    await table('Measurements').getByText('bench, today').waitFor()
    await becomes(async () => (await tableCells(table('Other measurements')))[1], ['Drained angle', '', '41.00', '1.41', '°', '2'])
    const { measurements } = await service.get('/v1/powders/flour')
    assert.ok(Math.abs(measurements[0].repose_deg - 45) < 1e-9)
  })

  it('comes back as the file that the service exports', async () => {
    await page.keyboard.press('Escape')
    const { name, text } = await fileOf('Download all measurements (CSV)')
    assert.equal(name, 'salt-all-measurements.csv')
    const response = await fetch(`${service.url}/v1/powders/salt/measurements.csv`)
    assert.equal(text, await response.text())
    assert.equal(text.trim().split('\n').length, 1 + 3 + 1)
  })
})

describe('a powder', () => {
  it('shows a set twice that two calibrations keep', async () => {
    const sand = await service.get('/v1/powders/sand')
    const twice = { ...sand, sets: [...sand.sets, ...sand.sets] }
    await page.route('**/v1/powders/sand', (route) => route.fulfill({ json: twice }))
    await chromium.open(page, 'powders/sand')
    await table('Calibrated parameter sets').waitFor()
    await becomes(async () => (await tableCells(table('Calibrated parameter sets'))).length, 1 + 4)
    await chromium.open(page)
    await page.getByRole('table').first().waitFor()
    await page.unrouteAll()
  })
})

describe('a calibration', () => {
  it('is downloaded as JSON, its sets and its trials as CSV with every digit', async () => {
    const { id } = made.sugar
    await chromium.open(page, `calibrations/${id}`)
    const calibration = await service.get(`/v1/calibrations/${id}`)
    assert.deepEqual(JSON.parse((await fileOf('Calibration (JSON)')).text), calibration)
    const cells = (text) => text.trim().split('\r\n').map((line) => line.split(','))
    const [heading, ...sets] = cells((await fileOf('Sets (CSV)')).text)
    const column = (name) => sets.map((row) => row[heading.indexOf(name)])
    assert.deepEqual(column('friction').map(Number), calibration.result.sets.map((s) => s.parameters.friction))
    assert.deepEqual(column('repose_deg').map(Number), calibration.result.sets.map((s) => s.repose_deg))
    const { items } = await service.get(`/v1/calibrations/${id}/trials?limit=5000`)
    const trials = cells((await fileOf('Trials (CSV)')).text)
    assert.equal(trials.length - 1, items.length)
    assert.deepEqual(trials.slice(1).map((row) => row[trials[0].indexOf('seed')]), items.map((t) => String(t.seed)))
  })

  it('stands beside another one', async () => {
    await page.getByLabel('Compare with').selectOption(made.sand.id)
    await table('Calibrations compared').waitFor()
    const { rows } = await csvOf(page, 'Calibrations compared')
    const cells = Object.fromEntries(rows.map(([what, ...sides]) => [what, sides]))
    const compared = await service.get(`/v1/calibrations/${made.sugar.id}/compare?with=${made.sand.id}`)
    const sides = [compared.calibration, compared.with]
    assert.deepEqual(cells.Powder, ['Sugar', 'Sand'])
    assert.deepEqual(cells['Search runs'], sides.map((s) => String(s.evaluations)))
    assert.deepEqual(cells['Mean verified angle (°)'], sides.map((s) => s.repose_deg.toFixed(2)))
    assert.equal(rows.length, 1 + 9 + 9)
    // Sugar and sand need not agree.
    await page.getByRole('status').getByText(`They are of different powders, so their angles need not agree: the mean verified angles differ by ${Math.abs(compared.difference_deg).toFixed(2)}°.`).waitFor()
    await picture(page, 'comparison')
  })

  it('shows what was learnt of each parameter', async () => {
    // A true posterior needs the 240 heaps of the emulator, minutes of work: this one is small and made up, in the form that the API's own
    // tests compare over both transports. The calibration that it is shown with says that it has one.
    const keys = ['particle_diameter_mm', 'adhesion', 'particle_adhesion_scale', 'adhesion_offset_scale', 'friction', 'gravity_scale', 'damping', 'cohesion', 'particle_mass_ug']
    const learnt = (key) => (key === 'friction' ? 0.62 : 0)
    const posterior = {
      draws: [keys.map(() => 0.5), keys.map(() => 0.25)],
      repose_deg: [31.2, 31.6],
      parameters: keys.map((key) => ({ key, mean: 0.375, interval: [0.25, 0.5], learnt: learnt(key), inert: key === 'particle_mass_ug' })),
      together: [{ keys: ['friction', 'cohesion'], correlation: -0.71 }],
      effective: 180.4,
    }
    const { id } = made.sugar
    const calibration = await service.get(`/v1/calibrations/${id}`)
    calibration.result.posterior = 'f'.repeat(64)
    const observation = { observable: { kind: 'shake_mass', pitch_deg: 30, shake_mm: 4 }, mean: 1.2, sd: 0.3, n: 5 }
    calibration.result.observed = [{ observation, sha256: 'f'.repeat(64), built: 128, sets: [], mean: 3.4, agrees: false }]
    await page.route(`**/v1/calibrations/${id}`, (route) => route.fulfill({ json: calibration }))
    await page.route(`**/v1/calibrations/${id}/posterior`, (route) => route.fulfill({ json: posterior }))
    await chromium.open(page, `calibrations/${id}`)
    await page.getByText('from 2 draws (effective sample size 180)').waitFor()
    await becomes(async () => (await tableCells(table('Posterior of the parameters'))).length, 10)
    const rows = await tableCells(table('Posterior of the parameters'))
    assert.deepEqual(rows.find(([name]) => name === 'Friction'), ['Friction', '0.3750', '0.2500', '0.5000', '62', 'yes'])
    assert.equal(rows.find(([name]) => name === 'Mass').at(-1), 'no')
    await becomes(async () => (await tableCells(table('Parameters known only in combination'))).at(-1), ['Friction and Cohesion', '-0.71'])
    await page.getByText('between 31.2° and 31.6° (68 %)').waitFor()
    await becomes(async () => (await tableCells(table('Other measurements')))[1], ['Shake mass', 'pitch_deg 30, shake_mm 4', '1.20', '0.30', '5', '3.40', 'mg', 'no'])
    await page.unrouteAll()
  })
})

describe('these views', () => {
  it('have no fault that axe finds, and complain of nothing', async () => {
    for (const hash of ['powders/salt', `calibrations/${made.sugar.id}`]) {
      await chromium.open(page, hash)
      await page.locator('.sheet').first().waitFor()
      if (hash.startsWith('calibrations')) {
        await page.getByLabel('Compare with').selectOption(made.sand.id)
        await table('Calibrations compared').waitFor()
      }
      assert.deepEqual(await accessibilityFaults(page), [], hash)
    }
    assert.deepEqual(chromium.complaints, [])
  })

  it('fit a narrow window without scrolling sideways', async () => {
    await page.setViewportSize({ width: 400, height: 800 })
    for (const hash of ['powders/salt', `calibrations/${made.sugar.id}`]) {
      await chromium.open(page, hash)
      await page.locator('.sheet').first().waitFor()
      if (hash.startsWith('calibrations')) {
        await page.getByLabel('Compare with').selectOption(made.sand.id)
        await table('Calibrations compared').waitFor()
      }
      assert.ok(await fits(page), hash)
    }
  })
})
