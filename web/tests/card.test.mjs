/** The card of a powder beside its pile, from shakes of a file, and the probing run that it asks for, in a real Chromium. */
import assert from 'node:assert/strict'
import { after, before, describe, it } from 'node:test'
import { accessibilityFaults, becomes, csvOf, openBrowser, picture, unlock } from './browser.mjs'
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

/** Two strokes at each pitch; powder from 22 degrees on, twice as much with strokes of 16 mm as with those of 8 mm. */
function shakes() {
  const rows = ['weighing,powder,lot,pitch_deg,shake_mm,fell_mg,sd_mg,spoon_mg']
  for (const [name, shake] of [['a', 16], ['b', 8]]) {
    let spoon = 40
    for (const pitch of [14, 14, 18, 18, 22, 22, 26, 26]) {
      const fell = pitch < 22 ? 0 : (shake / 8) * (pitch - 20)
      rows.push([name, 'salt', 'L1', pitch, shake, fell, 0.1, spoon].join(','))
      spoon -= fell
    }
  }
  return rows.join('\n')
}
async function fill() {
  const headers = { authorization: `Bearer ${service.token}`, 'content-type': 'text/csv' }
  const answer = await fetch(`${service.url}/v1/shakes/import`, { method: 'POST', headers, body: shakes() })
  assert.equal(answer.status, 201, await answer.text())
}
const card = () => page.locator('section', { has: page.getByRole('heading', { name: 'How it leaves the spoon' }) })
const fact = (name) => card().locator('dl div', { has: page.locator('dt', { hasText: name }) }).locator('dd')

describe('the card of a powder', () => {
  it('says what is missing while nothing was shaken', async () => {
    await chromium.open(page, 'powders/salt')
    await card().getByText('No card yet: 0 of at least 2 spoonfuls').waitFor()
    assert.equal(await card().locator('dl').count(), 0)
  })

  it('shows onset, slope, scatter and the curves of each stroke with their bands', async () => {
    await fill()
    await chromium.open(page)
    await chromium.open(page, 'powders/salt')
    await card().getByText('2 spoonfuls, 16 shakes').waitFor()
    assert.match(await fact('Begins to flow at').textContent(), /^22\.0° 22\.0 to 22\.0$/)
    assert.match(await fact('Slope of ln mg').textContent(), /^0\.\d{3} per ° /)
    await card().getByText('Lots: L1 (2).').waitFor()
    await card().getByText('Table of Mass of a stroke over the pitch').click()
    const { rows } = await csvOf(page, 'Mass of a stroke over the pitch')
    assert.deepEqual(rows.map((cells) => cells[0]).slice(1), ['14.0', '18.0', '22.0', '26.0'])
    const column = (name) => rows.slice(1).map((cells) => cells[rows[0].findIndex((title) => title.startsWith(name))])
    assert.deepEqual(column('Full stroke, 16.0 mm'), ['0.00', '0.00', '4.00', '12.00'])
    assert.deepEqual(column('Half stroke, 8.0 mm'), ['0.00', '0.00', '2.00', '6.00'])
    assert.ok(Number(column('Half stroke, 8.0 mm: low')[2]) < 2)
    assert.deepEqual(await accessibilityFaults(page), [])
    await picture(page, 'powder-card')
  })

  it('asks for a probing run once, and shows it as one', async () => {
    await unlock(page, service.token)
    const id = '01930000-0000-7000-8000-000000000001'
    const run = {
      id, powder: 'salt', target_mg: 146, tolerance_lower_mg: 0, tolerance_upper_mg: 0, policy: 'p-1', parameter_set: 'ps-1', seed: 1, state: 'done', outcome: 'probed',
      asked: { on_overdose: { action: 'stop' }, probe: { spoonfuls: 3 } }, reading_mg: 92, shakes: 60, seconds: 400, created_at: '2026-01-02T03:04:05Z', bench: 'emulated',
    }
    const keys = []
    await page.route('**/v1/characterisations', async (route) => {
      keys.push(await route.request().headerValue('idempotency-key'))
      assert.deepEqual(route.request().postDataJSON(), { powder: 'salt', vial_check: 'confirm' })
      // The first answer is lost; the same run is asked for again.
      if (keys.length === 1) return route.abort()
      await route.fulfill({ status: 202, json: { ...run, state: 'planned', outcome: null } })
    })
    await page.route(`**/v1/weighings/${id}`, (route) => route.fulfill({ json: { weighing: run, ticks: [] } }))
    const press = () => card().getByRole('button', { name: 'Probe this powder' }).click()
    await press()
    await card().getByRole('alert').getByText('It is not known whether the probing run was accepted').waitFor()
    await press()
    await page.getByRole('heading', { name: 'Probing run of Salt' }).waitFor()
    assert.ok(keys.length === 2 && keys[0] === keys[1] && keys[0].length > 30, keys.join())
    await becomes(() => page.locator('.verdict .badge').textContent(), 'Probed')
    assert.equal(await page.getByRole('link', { name: 'Certificate' }).count(), 0)
    await page.unrouteAll()
  })
})
