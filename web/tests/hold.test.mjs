/** A bench that is held or latched, with doses that wait, and a vial that a person puts in. */
import assert from 'node:assert/strict'
import { after, before, beforeEach, describe, it } from 'node:test'
import { accessibilityFaults, becomes, fits, openBrowser, picture, unlock } from './browser.mjs'
import { startService } from './service.mjs'

let service, chromium, page, bench

before(async () => {
  service = await startService()
  bench = await service.get('/v1/bench')
  chromium = await openBrowser(service.url)
  page = await chromium.tab()
  await chromium.open(page)
  await unlock(page, service.token)
}, { timeout: 60_000 })

after(async () => {
  await chromium?.browser.close()
  await service?.stop()
})

beforeEach(() => page.unrouteAll())

const ID = '01930000-0000-7000-8000-00000000000'
const AT = '2026-01-02T03:04:05Z'
const WAITING = [
  { id: `${ID}1`, powder: 'salt', target_mg: 12, vial: 'A1', state: 'awaiting_vial' },
  { id: `${ID}2`, powder: 'sand', target_mg: 8.5, vial: null, state: 'planned' },
]
const HELD = { at: AT, reason: 'a person stopped the bench', by: 'Ada' }
const LATCH = { at: AT, reason: 'The process ended while the spoon moved: look at spoon and vial.', weighing: `${ID}3` }
/** The bench as the service tells it, changed; kept until it is cleared or resumed. */
async function pretend(changes, said = []) {
  let now = { ...bench, waiting: [], ...changes }
  await page.route('**/v1/bench', (route) => route.fulfill({ json: now }))
  for (const [path, after] of [['resume', { held: null }], ['clear', { latch: null, held: HELD }]])
    await page.route(`**/v1/bench/${path}`, (route) => {
      said.push(route.request().postDataJSON())
      now = { ...now, ...after }
      return route.fulfill({ json: now })
    })
  return said
}
const strip = () => page.getByRole('region', { name: 'Bench now' })
const doses = () => page.getByRole('list', { name: 'Waiting doses' }).getByRole('listitem').allTextContents()

describe('a held bench', () => {
  it('is told on every view, with who stopped it and that doses wait', async () => {
    await pretend({ held: HELD, waiting: WAITING })
    for (const view of ['', 'weighings', 'jobs', 'powders/sand']) {
      await chromium.open(page, view)
      await strip().getByText(/^Stopped by Ada at .*2026.*: nothing starts until someone resumes the bench\.$/).waitFor()
      await strip().getByText('2 doses are waiting.').waitFor()
      assert.equal(await strip().getByRole('button', { name: 'Stop' }).count(), 0)
    }
  })

  it('is resumed where it is seen, on any view and by the keyboard, with the doses that begin then', async () => {
    for (const width of [1440, 390]) {
      await page.setViewportSize({ width, height: 900 })
      const said = await pretend({ held: HELD, waiting: WAITING })
      await chromium.open(page, 'jobs')
      await strip().getByRole('button', { name: 'Resume the bench' }).press('Enter')
      const panel = page.getByRole('dialog', { name: 'Resume the bench' })
      await becomes(() => panel.getByRole('listitem').count(), 2)
      assert.deepEqual(await accessibilityFaults(page), [])
      assert.ok(await fits(page))
      await picture(page, `resume-${width}`)
      await panel.getByLabel('Your name').fill('Grace')
      await panel.getByRole('button', { name: 'Resume', exact: true }).press('Enter')
      await panel.waitFor({ state: 'detached' })
      assert.deepEqual(said, [{ by: 'Grace', note: '' }])
      await page.waitForURL(/#\/jobs$/)
    }
    await page.setViewportSize({ width: 1400, height: 900 })
  })

  for (const scheme of ['light', 'dark']) {
    it(`has no fault that axe finds, nor a line too wide for a phone, in the ${scheme} theme`, async () => {
      const phone = await chromium.tab({ viewport: { width: 390, height: 844 }, colorScheme: scheme })
      await phone.route('**/v1/bench', (route) => route.fulfill({ json: { ...bench, held: HELD, waiting: WAITING, vial: { name: 'A0', weighing: `${ID}4`, holds_mg: 11.9, since: AT }, exchanges_vials: false } }))
      await chromium.open(phone, 'bench')
      await phone.getByRole('form', { name: 'Resume the bench' }).waitFor()
      assert.deepEqual(await accessibilityFaults(phone), [])
      assert.ok(await fits(phone))
      await picture(phone, `held-phone-${scheme}`)
      await phone.context().close()
    })
  }

  it('is resumed by a person with a name, who sees which doses begin then', async () => {
    const said = await pretend({ held: HELD, waiting: WAITING })
    await chromium.open(page, 'bench')
    await page.locator('main .badge').getByText('Held', { exact: true }).waitFor()
    await becomes(async () => (await doses()).map((text) => text.trim()), ['12.00 mg of Salt into vial A1 Awaiting vial', '8.50 mg of Sand Planned'])
    await picture(page, 'held')
    const resume = page.getByRole('button', { name: 'Resume', exact: true })
    // The name of the token is suggested; somebody has to be named.
    await becomes(() => page.getByLabel('Your name').inputValue(), 'first start')
    await page.getByLabel('Your name').fill('')
    await resume.click()
    await becomes(() => page.getByLabel('Your name').evaluate((box) => box.validity.valueMissing), true)
    await page.getByLabel('Your name').fill('Grace')
    await page.getByLabel('Note').fill('door closed')
    await resume.click()
    await resume.waitFor({ state: 'detached' })
    assert.deepEqual(said, [{ by: 'Grace', note: 'door closed' }])
  })
})

describe('a latched bench with doses that wait', () => {
  const clear = async () => {
    await page.getByLabel('Your name').fill('Ada')
    await page.getByLabel('I have inspected the spoon, the vial and the balance.').check()
    await page.getByLabel('The vial is empty or new').check()
    await page.getByRole('button', { name: 'Clear the bench' }).click()
  }

  it('names them before it is cleared, and leaves them held', async () => {
    const said = await pretend({ latch: LATCH, waiting: WAITING })
    await chromium.open(page, 'bench')
    await page.getByText('These doses are waiting. They stay on hold until someone resumes the bench').waitFor()
    await becomes(async () => (await doses()).length, 2)
    assert.equal(await page.getByLabel('Start them').isChecked(), false)
    await picture(page, 'latched-waiting')
    assert.deepEqual(await accessibilityFaults(page), [])
    await clear()
    await page.getByRole('form', { name: 'Resume the bench' }).waitFor()
    assert.deepEqual(said, [{ by: 'Ada', note: '', looked: true, vial_ready: true }])
  })

  it('lets them begin only where a person ticks that', async () => {
    const said = await pretend({ latch: LATCH, waiting: WAITING })
    await chromium.open(page, 'bench')
    await page.getByLabel('Start them').check()
    await clear()
    await page.getByRole('form', { name: 'Clear the bench' }).waitFor({ state: 'detached' })
    assert.equal(said[0].resume, true)
  })

  it('says so on every other view, with its reason', async () => {
    await pretend({ latch: LATCH })
    for (const view of ['', 'weighings', 'jobs']) {
      await chromium.open(page, view)
      await strip().getByText(LATCH.reason).waitFor()
      await strip().getByRole('link', { name: 'Inspect, then clear it' }).waitFor()
    }
    assert.deepEqual(await accessibilityFaults(page), [])
  })
})

describe('a dose whose vial is not in yet', () => {
  const weighing = {
    id: `${ID}1`, powder: 'salt', target_mg: 12, tolerance_lower_mg: 1, tolerance_upper_mg: 1, policy: 'p-1', parameter_set: 'ps-1', seed: 1, state: 'awaiting_vial',
    asked: { lot: 'L-7', vial: 'A1', operator: 'Ada' }, created_at: AT,
  }

  it('asks for the vial that it names, and goes on when a person says that it is in', async () => {
    let now = weighing
    const said = []
    await pretend({ waiting: WAITING, vial: { name: 'A0', weighing: `${ID}4`, holds_mg: 11.9, since: AT }, exchanges_vials: false })
    await page.route(`**/v1/weighings/${ID}1`, (route) => route.fulfill({ json: { weighing: now, ticks: [] } }))
    await page.route('**/vial-ready', (route) => {
      said.push(route.request().postDataJSON())
      now = { ...now, state: 'armed' }
      return route.fulfill({ json: now })
    })
    await chromium.open(page)
    await strip().getByRole('link', { name: 'Insert vial A1, then confirm' }).click()
    await page.getByRole('heading', { name: 'Insert vial A1, then confirm' }).waitFor()
    await page.getByText('vial A0, with 11.90 mg in it').waitFor()
    await picture(page, 'awaiting-vial')
    assert.deepEqual(await accessibilityFaults(page), [])
    await page.getByLabel('Text on the vial label').fill('A1')
    await page.getByLabel('Your name').fill('Ada')
    await page.getByRole('button', { name: 'Vial A1 is in' }).click()
    await page.locator('.verdict .badge').getByText('Armed').waitFor()
    assert.deepEqual(said, [{ by: 'Ada', vial: 'A1' }])
  })

  it('shows what is known of the vial on the pan', async () => {
    await pretend({ vial: { name: 'A0', weighing: `${ID}4`, holds_mg: 11.9, since: AT }, exchanges_vials: false })
    await chromium.open(page, 'bench')
    await becomes(() => page.getByLabel('Vial on the pan').textContent(), /A0.*Contents\s*11\.90 mg/s)
  })

  it('is asked for with lot, vial and operator, and with no question only where a person chose that', async () => {
    const said = []
    await page.route('**/v1/weighings', (route) => {
      if (route.request().method() !== 'POST') return route.continue()
      said.push(route.request().postDataJSON())
      return route.fulfill({ status: 400, contentType: 'application/problem+json', json: { type: 'urn:flip:problem:invalid', title: 'The request is not valid', status: 400, detail: '', errors: [{ field: 'asked.vial', message: 'is in use' }] } })
    })
    await chromium.open(page, 'weighings?new=dose')
    const form = page.getByRole('form', { name: 'Weigh a dose' })
    await form.getByLabel('Powder', { exact: true }).selectOption('sand')
    for (const [field, text] of [['Lot of the powder', 'L-7'], ['Vial', 'A1'], ['Operator', 'Ada']]) await form.getByLabel(field, { exact: true }).fill(text)
    const weigh = form.getByRole('button', { name: 'Weigh' })
    await weigh.click()
    await page.getByRole('alert').waitFor()
    await becomes(() => form.getByLabel('Vial', { exact: true }).getAttribute('aria-invalid'), 'true')
    await form.getByLabel('Skip the vial check').check()
    await weigh.click()
    await becomes(() => said.length, 2)
    assert.deepEqual(said.map(({ asked, vial_check }) => [asked, vial_check]), [[{ lot: 'L-7', vial: 'A1', operator: 'Ada' }, undefined], [{ lot: 'L-7', vial: 'A1', operator: 'Ada' }, 'skip']])
  })
})
