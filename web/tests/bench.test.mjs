/** The bench, its latch and its record, and what a weighing measured, in a real Chromium before a real `flip serve`. */
import assert from 'node:assert/strict'
import { readFileSync } from 'node:fs'
import { after, before, describe, it } from 'node:test'
import { accessibilityFaults, becomes, csvAsShown, fits, openBrowser, picture, unlock } from './browser.mjs'
import { startService } from './service.mjs'

let service, chromium, page
const made = {}

before(async () => {
  service = await startService()
  const { id } = await service.post('/v1/calibrations', { powder: 'sand', method: 'sequential', sets: 2, tolerance_deg: 5, trials_max: 60, particles: 400 })
  await service.finished(id)
  const dose = { powder: 'sand', target: { value: 12, unit: 'mg' }, tolerance: { lower: 1, upper: 1, unit: 'mg' } }
  made.weighing = (await service.post('/v1/weighings', dose, { 'idempotency-key': 'for-the-bench' })).id
  for (let k = 0; (await service.get('/v1/bench')).moving || !(await detail()).weighing.finished_at; k++) {
    assert.ok(k < 600, 'the weighing ends')
    await new Promise((resolve) => setTimeout(resolve, 200))
  }
  chromium = await openBrowser(service.url)
  page = await chromium.tab()
}, { timeout: 900_000 })

after(async () => {
  await chromium?.browser.close()
  await service?.stop()
})

const detail = () => service.get(`/v1/weighings/${made.weighing}`)
const table = (caption) => page.getByRole('table', { name: caption, exact: true })
/** Values of a list of facts by their names. */
const facts = (list) => list.evaluate((dl) => Object.fromEntries([...dl.querySelectorAll('div')].map((fact) => [fact.querySelector('dt').textContent, fact.querySelector('dd').textContent.trim()])))
/** The bench as the service tells it, changed: a simulated one neither latches nor moves for long. */
async function pretend(changes) {
  const bench = { ...(await service.get('/v1/bench')), ...changes }
  await page.route('**/v1/bench', (route) => route.fulfill({ json: bench }))
}
const latch = () => ({ at: '2026-01-02T03:04:05Z', reason: 'The process ended while the spoon moved: look at spoon and vial.', weighing: made.weighing })

describe('the bench', () => {
  it('says what it is made of and that it may be used', async () => {
    await chromium.open(page)
    await page.getByRole('navigation', { name: 'Bench' }).getByRole('link', { name: 'Devices and record' }).click()
    await page.getByRole('heading', { name: 'Bench', level: 1 }).waitFor()
    await page.locator('main .badge').getByText('Ready').waitFor()
    await page.getByText('Simulated: the simulator only, no devices').waitFor()
    assert.equal(await page.getByRole('button', { name: 'Stop', exact: true }).count(), 0)
    assert.equal(await page.getByRole('form', { name: 'Clear the bench' }).count(), 0)
  })

  it('names its devices, and has a stop that stays in sight while something moves', async () => {
    await pretend({ kind: 'devices', devices: { balance: 'Mettler Toledo XPR205, no. 42', arm: 'Franka FR3' }, moving: made.weighing })
    await chromium.open(page, 'bench')
    await unlock(page, service.token)
    await becomes(() => facts(page.getByLabel('Devices', { exact: true })), { Balance: 'Mettler Toledo XPR205, no. 42', Arm: 'Franka FR3' })
    await page.getByText('This button is not an emergency stop; the emergency stop is wired.').waitFor()
    const stop = page.getByRole('button', { name: 'Stop', exact: true })
    await page.evaluate(() => scrollTo(0, document.body.scrollHeight))
    await becomes(() => page.title(), /^Moving · Devices and record · FLIP$/)
    const { y } = await stop.boundingBox()
    assert.ok(y >= 0 && y < 900, `the button is at ${y}`)
    await picture(page, 'bench-moving')
    // What really moves is nothing, and the page asks every two seconds: it may be told so only after the stop, or the button is gone before it is pressed.
    const answered = page.waitForResponse('**/v1/bench/stop')
    await stop.click()
    assert.equal((await answered).status(), 200)
    await page.unrouteAll()
    await stop.waitFor({ state: 'detached' })
    await page.locator('main .badge').getByText('Held', { exact: true }).waitFor()
  })

  it('is held after a stop until a person resumes it', async () => {
    assert.ok((await service.get('/v1/bench')).held)
    await page.getByText('No doses are waiting.').waitFor()
    await page.getByLabel('Your name').fill('Grace')
    await page.getByRole('button', { name: 'Resume', exact: true }).click()
    await page.locator('main .badge').getByText('Ready').waitFor()
    assert.equal((await service.get('/v1/bench')).held, null)
  })

  it('asks for a token before it stops anything', async () => {
    const stranger = await chromium.tab()
    const bench = { ...(await service.get('/v1/bench')), moving: made.weighing }
    await stranger.route('**/v1/bench', (route) => route.fulfill({ json: bench }))
    await chromium.open(stranger, 'bench')
    await stranger.getByRole('button', { name: 'Stop', exact: true }).click()
    await stranger.getByRole('dialog').getByLabel('Token').waitFor()
    await stranger.context().close()
  })
})

describe('the wall screen', () => {
  it('shows what moves, how much has fallen, who is next, and a stop', async () => {
    const { weighing, ticks } = await detail()
    const waiting = [{ id: made.weighing, powder: weighing.powder, target_mg: 7, vial: 'V9', state: 'planned' }, { id: '01930000-0000-7000-8000-000000000009', powder: weighing.powder, target_mg: 8, vial: null, state: 'planned' }]
    await pretend({ moving: made.weighing, waiting })
    await chromium.open(page, 'bench')
    await page.getByRole('link', { name: 'Wall screen' }).click()
    await page.getByRole('heading', { name: 'Moving', level: 1 }).waitFor()
    const digits = page.locator('.wall .digits')
    await becomes(async () => Number((await digits.textContent()).replace('−', '-')), ticks.at(-1).reading.mass_mg)
    const shown = await digits.textContent()
    assert.ok(parseFloat(await digits.evaluate((it) => getComputedStyle(it).fontSize)) >= 96)
    const meter = page.getByRole('meter', { name: 'Mass in the vial, mg' })
    await becomes(() => meter.getAttribute('aria-valuetext'), `${shown} of ${weighing.target_mg.toFixed(2)} mg`)
    await page.getByText(/Next: 7\.00 mg of .*, vial V9\. 2 doses are waiting/).waitFor()
    assert.equal(await page.getByRole('navigation').count(), 0)
    const { height } = await page.getByRole('button', { name: 'Stop', exact: true }).boundingBox()
    assert.ok(height >= 48, `${height} px`)
    assert.deepEqual(await accessibilityFaults(page), [])
    await picture(page, 'wall-moving')
  })

  it('says that nothing waits, why the bench is latched, and fits a phone', async () => {
    await page.unrouteAll()
    await pretend({ latch: latch(), moving: null, waiting: [] })
    await chromium.open(page, 'wall')
    await page.getByRole('heading', { name: 'Latched', level: 1 }).waitFor()
    await page.getByText(latch().reason).waitFor()
    await page.getByText('No doses are waiting.').waitFor()
    assert.deepEqual(await accessibilityFaults(page), [])
    for (const width of [390, 1280, 1440]) {
      await page.setViewportSize({ width, height: 844 })
      assert.ok(await fits(page), `${width} px`)
    }
    await picture(page, 'wall-latched')
    await page.setViewportSize({ width: 1400, height: 900 })
    await page.unrouteAll()
    await page.getByRole('link', { name: 'Back to the bench' }).click()
    await page.getByRole('heading', { name: 'Bench', level: 1 }).waitFor()
  })
})

describe('a latched bench', () => {
  it('says why, and is cleared only by a person who ticks both boxes', async () => {
    await pretend({ latch: latch() })
    await chromium.open(page, 'bench')
    await unlock(page, service.token)
    await page.locator('main .badge').getByText('Latched').waitFor()
    await page.getByText(latch().reason).waitFor()
    await becomes(() => page.title(), /^Latched · Devices and record · FLIP$/)
    const icon = () => page.locator('link[rel=icon]').evaluate((link) => link.href)
    await becomes(icon, /mark-latched\.svg$/)
    assert.equal((await fetch(await icon())).headers.get('content-type'), 'image/svg+xml')
    assert.equal(await page.getByRole('link', { name: 'this weighing' }).getAttribute('href'), `#/weighings/${made.weighing}`)
    await picture(page, 'bench-latched')
    const said = []
    await page.route('**/v1/bench/clear', async (route) => {
      said.push(route.request().postDataJSON())
      await route.continue()
    })
    const clear = page.getByRole('button', { name: 'Clear the bench' })
    await page.getByLabel('Your name').fill('Ada')
    await page.getByLabel('Note').fill('vial emptied')
    await page.getByLabel('I have inspected the spoon, the vial and the balance.').check()
    await clear.click()
    await becomes(() => page.getByLabel('The vial is empty or new').evaluate((box) => box.validity.valueMissing), true)
    assert.deepEqual(said, [])
    await page.getByLabel('The vial is empty or new').check()
    await clear.click()
    // The service knows of no latch: its refusal is shown as any other.
    await page.getByRole('alert').getByText('the bench is not latched').waitFor()
    assert.deepEqual(said, [{ by: 'Ada', note: 'vial emptied', looked: true, vial_ready: true }])
  })

  it('shows no form any more once it is cleared', async () => {
    const cleared = await service.get('/v1/bench')
    await page.unroute('**/v1/bench/clear')
    // It is latched until it is cleared: the page may ask at any time.
    await page.route('**/v1/bench/clear', async (route) => {
      await page.unroute('**/v1/bench')
      await route.fulfill({ json: cleared })
    })
    await page.getByRole('button', { name: 'Clear the bench' }).click()
    await page.getByRole('form', { name: 'Clear the bench' }).waitFor({ state: 'detached' })
    await page.locator('main .badge').getByText('Ready').waitFor()
    await page.unrouteAll()
  })
})

describe('a repeatability check', () => {
  const keep = async (readings, step) => {
    await page.getByLabel('Readings (mg)').fill(readings)
    await page.getByLabel('Display step (mg)').fill(step)
    // By the keyboard: rows that arrive above move the button from under a click.
    await page.getByRole('button', { name: 'Save the check' }).press('Enter')
  }

  it('is refused beside the field when a reading is no number, or there are too few', async () => {
    await chromium.open(page, 'bench')
    await unlock(page, service.token)
    await keep('100,1\n100.2', '0.1')
    await page.getByRole('alert').getByText('`100,1` is not a number').waitFor()
    await keep('100.1\n100.2', '0.1')
    await page.getByRole('alert').getByText('at least 10 weighings').waitFor()
    await becomes(() => page.getByLabel('Readings (mg)').getAttribute('aria-invalid'), 'true')
    assert.ok(!(await service.get('/v1/bench')).repeatability)
  })

  it('gives the SD and the minimum weight, of the display step where that is coarser', async () => {
    await keep('100.0 100.2 100.0 100.2 100.0\n100.2; 100.0; 100.2; 100.0; 100.2', '0.1')
    const newest = page.getByLabel('Latest repeatability check')
    await newest.waitFor()
    // SD = sqrt(10 * 0.1² / 9) = 0.1054; 2 * 0.1054 / 0.001 = 210.8
    await becomes(() => facts(newest), { 'Standard deviation': '0.105 mg', 'Minimum weight': '210.8 mg', 'Display step': '0.100 mg', Readings: '10' })
    await keep(Array(10).fill('100').join('\n'), '1')
    await newest.getByText('820.0 mg').waitFor()
    const { repeatability } = await service.get('/v1/bench')
    assert.deepEqual([repeatability.sd_mg, repeatability.readability_mg], [0, 1])
  })
})

describe('the record', () => {
  it('shows its last records, newest first, each with its weighing', async () => {
    await chromium.open(page, 'bench')
    await table('Records').getByRole('link').first().waitFor()
    const { items } = await service.get('/v1/audit?limit=50')
    const rows = await csvAsShown(page, 'Records')
    assert.deepEqual(rows.slice(1).map(([seq, at]) => [Number(seq), at]), items.map((r) => [r.seq, r.at]))
    assert.ok(rows.slice(1).every(([, , , , text]) => text.length <= 121 && !/[{}"]/.test(text)), 'in words')
    assert.ok(rows.slice(1).some(([, , , weighing]) => weighing === `…${made.weighing.slice(-8)}`))
  })

  it('is found whole, with its number of records and its last hash', async () => {
    await page.getByRole('button', { name: 'Check the record' }).click()
    const said = page.getByRole('status').filter({ hasText: 'Records checked' })
    await said.getByText('The record is intact.').waitFor()
    const { records, last_hash } = await service.get('/v1/audit/verification')
    const text = (await said.textContent()).replaceAll('\u2009', '')
    assert.ok(text.includes(`Records checked: ${records}.`) && text.includes(last_hash), text)
  })

  it('is found broken at the record that was changed', async () => {
    await page.route('**/v1/audit/verification', (route) => route.fulfill({ json: { records: 6, last_hash: 'a'.repeat(64), broken: { seq: 7, why: 'it is not what was written' } } }))
    await page.getByRole('button', { name: 'Check the record' }).click()
    await page.getByRole('status').getByText('Broken at record 7: it is not what was written.').waitFor()
    await page.unrouteAll()
  })

  it('is downloaded whole as JSON and as CSV', async () => {
    const fileOf = async (name) => {
      const [file] = await Promise.all([page.waitForEvent('download'), page.getByRole('link', { name }).click()])
      return readFileSync(await file.path(), 'utf8')
    }
    const { records } = await service.get('/v1/audit/verification')
    assert.equal(JSON.parse(await fileOf('All records (JSON)')).length, records)
    assert.match(await fileOf('All records (CSV)'), /^seq,at,weighing,kind,body,hash\n1,/)
  })
})

describe('a weighing', () => {
  const show = async (changes) => {
    const { weighing, ticks } = await detail()
    await page.route(`**/v1/weighings/${made.weighing}`, (route) => route.fulfill({ json: { weighing: { ...weighing, ...changes }, ticks } }))
    await chromium.open(page, `weighings/${made.weighing}`)
    await page.locator('.verdict').waitFor()
  }

  it('that has ended leads to its certificate', async () => {
    await chromium.open(page, `weighings/${made.weighing}`)
    const link = page.getByRole('link', { name: 'Certificate' })
    assert.equal(await link.getAttribute('href'), `/v1/weighings/${made.weighing}/certificate.html`)
    const response = await fetch(service.url + (await link.getAttribute('href')))
    assert.equal(response.status, 200)
    assert.match(await response.text(), new RegExp(made.weighing))
  })

  it('shows what was measured, with its uncertainty and its devices', async () => {
    const measured = {
      tare_mg: 15000, gross_mg: 15012, net_mg: 12, uncertainty_mg: 0.82, minimum_mg: 210.8, below_minimum_weight: true, stable_by_balance: true, stable_by_window: false,
      drift_before_mg_min: 0.02, drift_after_mg_min: -0.05, devices: { balance: 'Mettler Toledo XPR205, no. 42' }, discarded_mg: [],
    }
    await show({ measured })
    const list = await facts(page.getByLabel('Measured mass'))
    // The balance of the simulated bench reads 1 mg; the uncertainty, and the net mass with it, is one decimal finer.
    assert.deepEqual([list.Net, list.Gross, list.Tare], ['12.0 ± 0.8 mg', '15012 mg', '15000 mg'])
    assert.deepEqual([list['Drift before'], list['Drift after']], ['+0.02 mg/min', '−0.05 mg/min'])
    assert.deepEqual([list['Balance reports stable'], list['Stable over the window'], list.Balance], ['yes', 'no', 'Mettler Toledo XPR205, no. 42'])
    assert.equal(list['Below minimum weight'], 'yes minimum 210.8 mg')
    await page.getByRole('status').getByText('below the minimum weight of this balance').waitFor()
    assert.deepEqual(await accessibilityFaults(page), [])
    await picture(page, 'weighing-measured')
    await page.unrouteAll()
  })

  it('has words for every way to stand and to end', async () => {
    for (const [changes, word] of [
      [{ outcome: 'not_stable' }, 'Not stable'],
      [{ outcome: 'blocked' }, 'Blocked'],
      [{ state: 'settling', outcome: null }, 'Settling'],
    ]) {
      await show(changes)
      await becomes(() => page.locator('.verdict .badge').textContent(), word)
      await becomes(() => page.getByRole('link', { name: 'Certificate' }).count(), changes.state ? 0 : 1)
      await page.unrouteAll()
    }
    await chromium.open(page, 'weighings')
    for (const word of ['Not stable', 'Blocked']) await page.getByLabel('Outcome').selectOption(word)
  })
})

describe('this view', () => {
  for (const scheme of ['light', 'dark']) {
    it(`has no fault that axe finds while latched and moving, in the ${scheme} theme`, async () => {
      await page.emulateMedia({ colorScheme: scheme })
      await pretend({ latch: latch(), moving: made.weighing })
      await chromium.open(page, 'bench')
      await table('Records').getByRole('link').first().waitFor()
      await page.getByRole('button', { name: 'Check the record' }).click()
      await page.getByRole('status').filter({ hasText: 'Records checked' }).waitFor()
      await page.evaluate(() => document.fonts.ready)
      await picture(page, `bench-all-${scheme}`)
      assert.deepEqual(await accessibilityFaults(page), [])
    })
  }

  it('fits a narrow window without scrolling sideways, and complains of nothing', async () => {
    await page.setViewportSize({ width: 400, height: 800 })
    await chromium.open(page, 'bench')
    await table('Records').getByRole('link').first().waitFor()
    await page.getByRole('button', { name: 'Check the record' }).click()
    await page.getByRole('status').filter({ hasText: 'Records checked' }).waitFor()
    assert.ok(await fits(page))
    assert.deepEqual(chromium.complaints, [])
  })
})
