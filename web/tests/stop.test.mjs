/** What the page says of a stop, and of what it shows when nobody answers. */
import assert from 'node:assert/strict'
import { after, afterEach, before, describe, it } from 'node:test'
import { accessibilityFaults, becomes, openBrowser, picture, unlock } from './browser.mjs'
import { startFront } from './front.mjs'
import { startService } from './service.mjs'

const STOP = '/v1/bench/stop'
let service, front, chromium, page, bench

before(async () => {
  service = await startService()
  front = await startFront(service.url)
  bench = await service.get('/v1/bench')
  chromium = await openBrowser(front.url)
  page = await chromium.tab()
  await chromium.open(page)
  await unlock(page, service.token)
}, { timeout: 60_000 })

after(async () => {
  await chromium?.browser.close()
  await front?.stop()
  await service?.stop()
})

afterEach(() => {
  front.does = () => undefined
  front.seen.length = 0
})

/** A simulated bench does not move for long: the front says that it does, and does `more` to a stop. */
const moving = (more) => {
  front.does = ({ method, path }) => {
    if (path === '/v1/bench') return { status: 200, body: { ...bench, moving: 'a-weighing' } }
    return method === 'POST' && path === STOP ? more : undefined
  }
}
const stop = () => page.getByRole('button', { name: 'Stop', exact: true })
const notSent = () => page.getByRole('alert').filter({ hasText: 'NOT sent: use the wired stop.' })

describe('a stop', () => {
  it('can be pressed on every view while something moves', async () => {
    moving()
    for (const view of ['', 'powders', 'weighings', 'bench', 'jobs']) {
      await chromium.open(page, view)
      await page.evaluate(() => scrollTo(0, document.body.scrollHeight))
      await stop().waitFor()
      const { y } = await stop().boundingBox()
      assert.ok(y >= 0 && y < 900, `on ${view} the button is at ${y}`)
    }
    assert.deepEqual(await accessibilityFaults(page), [])
  })

  it('can be pressed on every view while a pile is made', async () => {
    front.does = ({ path }) => path === '/v1/bench' ? { status: 200, body: { ...bench, piling: { job: 'a-measurement', pile: 2 } } } : undefined
    for (const view of ['', 'powders', 'weighings', 'bench', 'jobs']) {
      await chromium.open(page, view)
      await page.getByRole('region', { name: 'Bench now' }).getByText('Pile 2 of a measurement is being made').waitFor()
      await stop().waitFor()
    }
    const sent = page.waitForRequest((request) => request.method() === 'POST' && request.url().endsWith(STOP))
    await stop().click()
    await sent
    await page.getByRole('status').filter({ hasText: 'Stopped after' }).waitFor()
  })

  it('says at once that it is being sent, and after how long it was answered', async () => {
    moving('hang')
    await chromium.open(page, 'bench')
    await stop().click()
    await page.getByRole('button', { name: 'Sending…', disabled: true }).waitFor()
    await notSent().getByText('No response within 2 s.').waitFor()
    moving()
    await stop().click()
    await page.getByText(/^Stopped after \d+ ms$/).waitFor()
    await becomes(() => notSent().count(), 0)
    await picture(page, 'stop-stopped')
  })

  for (const [what, answer, why] of [
    ['refused by the service', { status: 403, kind: 'application/problem+json', body: { type: 'urn:flip:problem:forbidden', title: 'Not allowed', status: 403, detail: 'this needs the role operator; the token has viewer', errors: [] } }, 'the token has viewer'],
    ['answered with a fault', { status: 500, body: 'no' }, 'The service returned 500'],
    ['answered by a machine between', { status: 502 }, 'The service returned 502'],
    ['cut off', 'cut', 'The service is not responding.'],
  ]) {
    it(`that is ${what} is not sent, and says why`, async () => {
      moving(answer)
      await chromium.open(page, 'bench')
      await stop().click()
      await notSent().getByText(why).waitFor()
      await becomes(() => stop().isEnabled(), true)
      await picture(page, 'stop-not-sent')
      assert.deepEqual(await accessibilityFaults(page), [])
    })
  }

  it('that failed is never sent again by itself, only by another press', async () => {
    moving({ status: 503 })
    await chromium.open(page, 'bench')
    await stop().click()
    await notSent().waitFor()
    moving()
    const asked = front.count('GET', '/v1/bench')
    while (front.count('GET', '/v1/bench') < asked + 2) await page.waitForResponse('**/v1/bench')
    assert.equal(front.count('POST', STOP), 1)
    await notSent().waitFor()
    await stop().click()
    await page.getByText(/^Stopped after \d+ ms$/).waitFor()
    assert.equal(front.count('POST', STOP), 2)
  })

  it('pressed twice in a row is sent once', async () => {
    moving('hang')
    await chromium.open(page, 'bench')
    await stop().waitFor()
    await stop().evaluate((button) => (button.click(), button.click(), button.click()))
    await notSent().waitFor()
    assert.equal(front.count('POST', STOP), 1)
  })

  it('does not wait for the file of the views that are opened less often', async () => {
    moving()
    const { does } = front
    const bench = (request) => request.path === '/v1/bench' || request.path === '/v1/events' || request.method === 'POST'
    const one = await chromium.tab()
    const tabs = [one]
    while (tabs.length < 6) tabs.push(await chromium.beside(one.context()))
    for (const tab of tabs) await chromium.open(tab, 'bench')
    await unlock(one, service.token)
    // From here on nothing is answered before the stop has come but what a stop is made of.
    front.does = (request) => (front.count('POST', STOP) === 0 && !bench(request) ? 'hang' : does(request))
    const later = () => front.seen.filter(({ path, open }) => path.startsWith('/assets/later') && open).length
    for (const tab of tabs) await tab.evaluate(() => (location.hash = '#/weighings'))
    await one.evaluate(() => (location.hash = '#/simulators'))
    await one.getByText('Loading…').waitFor()
    const taken = () => front.seen.filter(({ open }) => open).length
    for (let k = 0; taken() < 6; k++) {
      assert.ok(k < 100, `${taken()} of six connections are taken`)
      await new Promise((go) => setTimeout(go, 100))
    }
    await one.getByRole('button', { name: 'Stop', exact: true }).click()
    await one.getByText(/^Stopped after \d+ ms$/).waitFor()
    assert.equal(front.count('POST', STOP), 1)
    // What gave way is asked for again, and the view comes.
    await one.getByRole('heading', { name: 'Simulators', level: 1 }).waitFor()
    await becomes(later, 0)
    await one.context().close()
  })

  it('is at hand where a narrow window is scrolled', async () => {
    const phone = await chromium.tab({ viewport: { width: 390, height: 844 } })
    moving()
    await chromium.open(phone, 'bench')
    await phone.evaluate(() => scrollTo(0, document.body.scrollHeight))
    const box = await phone.getByRole('button', { name: 'Stop', exact: true }).boundingBox()
    assert.ok(box.y >= 0 && box.y < 300 && box.height >= 38, JSON.stringify(box))
    await picture(phone, 'stop-phone')
    await phone.context().close()
  })
})

describe('the file of the views that are opened less often', () => {
  const late = (answer) => (front.does = ({ path }) => (path.startsWith('/assets/later') ? answer : undefined))

  it('can be asked for again when it did not arrive', async () => {
    const other = await chromium.tab()
    late({ status: 502 })
    await chromium.open(other, '')
    await other.getByRole('link', { name: 'Simulator', exact: true }).click()
    await other.getByRole('alert').getByText('The service returned 502').waitFor()
    assert.deepEqual(await accessibilityFaults(other), [])
    front.does = () => undefined
    await other.getByRole('button', { name: 'Try again' }).click()
    await other.getByRole('heading', { name: 'Simulators', level: 1 }).waitFor()
    await other.context().close()
  })

  it('of an earlier version asks for a reload', async () => {
    const other = await chromium.tab()
    late({ status: 404 })
    await chromium.open(other, '')
    await other.getByRole('link', { name: 'Simulator', exact: true }).click()
    await other.getByRole('alert').getByText('FLIP has been updated').waitFor()
    await picture(other, 'updated')
    front.does = () => undefined
    await other.getByRole('button', { name: 'Reload the page' }).click()
    await other.getByRole('heading', { name: 'Simulators', level: 1 }).waitFor()
    await other.context().close()
  })
})

describe('a service that does not answer', () => {
  it('leaves nothing on the page that looks like now', async () => {
    const weighing = { id: 'a-weighing', powder: 'sand', target_mg: 12, tolerance_lower_mg: 1, tolerance_upper_mg: 1, policy: 'p-1', parameter_set: 'ps-1', seed: 1, state: 'dosing', created_at: '2026-01-02T03:04:05Z' }
    const ticks = [{ step: 1, t_s: 1, reading: { mass_mg: 3, stable: true }, action: { incline_change_deg: 1, shake_mm: 1 }, pitch_deg: 10 }]
    moving()
    const { does } = front
    front.does = (request) => (request.path === '/v1/weighings/a-weighing' ? { status: 200, body: { weighing, ticks } } : does(request))
    await chromium.open(page, 'weighings/a-weighing')
    const balance = page.getByRole('group', { name: 'Balance', exact: true })
    await balance.getByText('balance reading').waitFor()
    await stop().waitFor()
    await front.stop()
    await balance.getByText('out of date: no response').waitFor()
    await page.locator('.verdict').getByText('at last contact').waitFor()
    await picture(page, 'weighing-old')
    assert.deepEqual(await accessibilityFaults(page), [])
    await page.evaluate(() => (location.hash = '#/bench'))
    const lost = page.getByRole('alert').filter({ hasText: 'The service has not responded since' })
    await lost.getByText('anything that was moving may still be moving: use the wired stop').waitFor()
    await page.getByText('Out of date: the service is not responding.').waitFor()
    await picture(page, 'service-lost')
    await stop().click()
    await notSent().getByText('The service is not responding.').waitFor()
    assert.deepEqual(await accessibilityFaults(page), [])
  })
})
