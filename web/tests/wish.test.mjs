/** A dose that was asked for is poured once, whatever became of the answer. */
import assert from 'node:assert/strict'
import { after, afterEach, before, describe, it } from 'node:test'
import { becomes, openBrowser, openPanel, picture, unlock } from './browser.mjs'
import { startFront } from './front.mjs'
import { startService } from './service.mjs'

const WEIGHINGS = '/v1/weighings'
let service, front, chromium, page

before(async () => {
  service = await startService()
  const { id } = await service.post('/v1/calibrations', { powder: 'sand', method: 'sequential', sets: 2, tolerance_deg: 5, trials_max: 60, particles: 400 })
  await service.finished(id)
  front = await startFront(service.url)
  chromium = await openBrowser(front.url)
  page = await chromium.tab()
}, { timeout: 900_000 })

after(async () => {
  await chromium?.browser.close()
  await front?.stop()
  await service?.stop()
})

afterEach(() => {
  front.does = () => undefined
  front.seen.length = 0
})

const posts = () => front.seen.filter((request) => request.method === 'POST' && request.path === WEIGHINGS)
const keys = () => new Set(posts().map((request) => request.key))
const stored = async () => (await service.get(WEIGHINGS)).items.length
/** Each case is another dose: what nobody answered before stays in the tab. */
let target = 10
const fill = async () => {
  await chromium.open(page, 'weighings')
  if (!(await page.getByRole('button', { name: /Token set/ }).count())) await unlock(page, service.token)
  await openPanel(page, 'Weigh a dose')
  await page.getByRole('form', { name: 'Weigh a dose', exact: true }).getByLabel('Powder', { exact: true }).selectOption('sand')
  await page.getByLabel('Target', { exact: true }).fill(String(target))
}
const weigh = () => page.getByRole('button', { name: 'Weigh', exact: true }).click()
const lost = () => page.getByRole('status').filter({ hasText: 'It is not known whether' })
const answers = (wanted) => (front.does = ({ method, path }) => (method === 'POST' && path === WEIGHINGS ? wanted : undefined))
const taken = () => page.waitForURL(/#\/weighings\/[0-9a-f-]{36}/)
const saysBefore = () => page.getByRole('status').getByText('This dose had already been accepted').waitFor()

describe('a dose whose answer was lost', () => {
  for (const [what, wanted] of [
    ['a fault of the service', { after: true, status: 500, kind: 'application/problem+json', body: { type: 'urn:flip:problem:internal', title: 'Internal error', status: 500, detail: '', errors: [] } }],
    ['a bad gateway', { after: true, status: 502 }],
    ['a gateway that knows no such page', { after: true, status: 404 }],
    ['a page of another machine', { after: true, status: 200 }],
    ['a broken connection', 'cut'],
  ]) {
    it(`to ${what} is poured once when it is asked for again`, async () => {
      target += 1
      const before = await stored()
      await fill()
      answers(wanted)
      await weigh()
      await lost().getByText(`${target}.00 mg of Sand`).waitFor()
      assert.equal(await stored(), before + 1)
      answers()
      await weigh()
      await taken()
      await saysBefore()
      // The browser itself sends again what it sent over a connection that was cut.
      assert.ok(posts().length >= 2)
      assert.deepEqual([keys().size, await stored()], [1, before + 1])
    })
  }

  it('keeps its key and its contents over a reload of the page', async () => {
    target += 1
    const before = await stored()
    await fill()
    answers({ after: true, status: 502 })
    await weigh()
    await lost().waitFor()
    await picture(page, 'weighing-lost')
    answers()
    await page.reload()
    await lost().getByText(`${target}.00 mg of Sand`).waitFor()
    await becomes(() => page.getByLabel('Target').inputValue(), String(target))
    await weigh()
    await taken()
    await saysBefore()
    assert.deepEqual([posts().length, keys().size, await stored()], [2, 1, before + 1])
  })

  it('keeps its key while another dose is asked for', async () => {
    target += 1
    const before = await stored()
    await fill()
    answers({ after: true, status: 500 })
    await weigh()
    await lost().waitFor()
    answers()
    await page.getByLabel('Target').fill('9.5')
    await weigh()
    await taken()
    await fill()
    await weigh()
    await taken()
    assert.deepEqual([posts().length, keys().size, await stored()], [3, 2, before + 2])
  })
})

describe('a dose that was answered', () => {
  it('is another dose when it is asked for again', async () => {
    target += 1
    const before = await stored()
    for (const _ of [1, 2]) {
      await fill()
      await weigh()
      await taken()
      await page.locator('.verdict').waitFor()
    }
    assert.deepEqual([keys().size, await stored(), await page.getByText('had already been accepted').count()], [2, before + 2, 0])
  })

  it('with a refusal has another key when it is asked for again', async () => {
    const before = await stored()
    await fill()
    await page.getByLabel('Target').fill('9000')
    for (const sent of [1, 2]) {
      await weigh()
      while (posts().length < sent) await page.waitForResponse(`**${WEIGHINGS}`)
      await page.getByRole('alert').waitFor()
    }
    assert.deepEqual([posts().length, keys().size, await stored(), await lost().count()], [2, 2, before, 0])
  })
})
