/** Many tabs of one browser: one event stream, and a stop that gets through. */
import assert from 'node:assert/strict'
import { after, afterEach, before, describe, it } from 'node:test'
import { fileURLToPath } from 'node:url'
import { createServer } from 'vite'
import { openBrowser, unlock } from './browser.mjs'
import { startFront } from './front.mjs'
import { startService } from './service.mjs'

const EVENTS = '/v1/events'
const STOP = '/v1/bench/stop'
let service, front, chromium, context

before(async () => {
  service = await startService()
  front = await startFront(service.url)
  chromium = await openBrowser(front.url)
}, { timeout: 60_000 })

after(async () => {
  await chromium?.browser.close()
  await front?.stop()
  await service?.stop()
})

afterEach(async () => {
  await context?.close()
  front.does = () => undefined
  front.seen.length = 0
})

/** So many tabs of one new browser, each at the bench and connected. */
async function tabs(count, script) {
  const first = await chromium.tab()
  context = first.context()
  if (script) await context.addInitScript(script)
  const pages = [first]
  while (pages.length < count) pages.push(await chromium.beside(context))
  for (const page of pages) {
    await chromium.open(page, 'bench')
    await page.getByText('Live', { exact: true }).waitFor()
  }
  return pages
}
/** Waits until the front sees what is asked. */
async function until(what, said) {
  for (let k = 0; !what(); k++) {
    assert.ok(k < 300, said)
    await new Promise((resolve) => setTimeout(resolve, 100))
  }
}
/** As a window that another one covers. */
const show = (page, state) =>
  page.evaluate((state) => {
    Object.defineProperty(document, 'visibilityState', { value: state, configurable: true })
    document.dispatchEvent(new Event('visibilitychange'))
  }, state)
const sayMoving = (bench) => (request) => (request.path === '/v1/bench' ? { status: 200, body: { ...bench, moving: 'a-weighing' } } : undefined)
const stopButton = (page) => page.getByRole('button', { name: 'Stop', exact: true })

describe('eight tabs', () => {
  it('share one event stream, and a stop pressed in one reaches the service', async () => {
    const bench = await service.get('/v1/bench')
    front.does = sayMoving(bench)
    const pages = await tabs(8)
    assert.equal(front.open(EVENTS), 1)
    const last = pages.at(-1)
    await unlock(last, service.token)
    await stopButton(last).click()
    await last.getByText(/^Stopped after \d+ ms$/).waitFor()
    assert.equal(front.count('POST', STOP), 1)
  })

  it('that wait for slow answers on every connection give way to a stop, and ask again after it', async () => {
    const bench = await service.get('/v1/bench')
    front.does = sayMoving(bench)
    const pages = await tabs(8)
    const last = pages.at(-1)
    await unlock(last, service.token)
    await stopButton(last).waitFor()
    // Nobody gets an answer before the stop has come.
    front.does = (request) => (front.count('POST', STOP) === 0 && request.method === 'GET' && request.path !== EVENTS ? 'hang' : sayMoving(bench)(request))
    for (const page of pages) await page.evaluate(() => (location.hash = '#/weighings'))
    await until(() => front.seen.filter((request) => request.open).length >= 6, 'every connection is taken')
    await stopButton(last).click()
    await last.getByText(/^Stopped after \d+ ms$/).waitFor()
    assert.equal(front.count('POST', STOP), 1)
    for (const page of pages) await page.getByText('No weighings yet.').waitFor()
  })

  it('that are hidden hold no stream, and ask for everything anew when they are shown', async () => {
    const pages = await tabs(3)
    for (const page of pages) await show(page, 'hidden')
    await until(() => front.open(EVENTS) === 0, 'no stream is left')
    const before = front.count('GET', '/v1/bench')
    await show(pages[1], 'visible')
    await until(() => front.open(EVENTS) === 1 && front.count('GET', '/v1/bench') > before, 'one stream is opened')
  })

  it('leave the stream to those that stay when they are closed, and end it with the last', async () => {
    const pages = await tabs(3)
    await pages[0].close()
    await pages[1].close()
    await service.post('/v1/powders', { id: 'seen_live', name: 'Seen live' })
    assert.equal(front.open(EVENTS), 1)
    await pages[2].close()
    await until(() => front.open(EVENTS) === 0, 'the stream ends with the last tab')
  })
})

describe('tabs with different tokens', () => {
  it('have a stream for each token', async () => {
    const pages = await tabs(3)
    await unlock(pages[0], service.token)
    await until(() => front.seen.filter((r) => r.path === EVENTS && r.open && r.token).length === 1, 'the token has its stream')
    assert.equal(front.open(EVENTS), 2)
  })

  it('never have more than two streams; who gets none is told to ask, and one that falls silent gives its stream away', async () => {
    const vite = await createServer({ root: fileURLToPath(new URL('..', import.meta.url)), server: { middlewareMode: true, ws: false, watch: null }, appType: 'custom', logLevel: 'error' })
    const { Hub, BEAT_MS } = await vite.ssrLoadModule('/src/events/hub.ts')
    let now = 0
    const open = []
    const connect = (token, follower) => {
      open.push(token)
      follower.open(true)
      return { close: () => open.splice(open.indexOf(token), 1) }
    }
    const hub = new Hub(connect, () => now)
    const told = [[], [], []]
    const here = (k) => hub.hear(members[k], { kind: 'here', token: `token-${k}`, visible: true })
    const members = told.map((heard) => ({ tell: (it) => heard.push(it.kind) }))
    for (const k of [0, 1, 2]) here(k)
    hub.beat()
    assert.deepEqual(open, ['token-0', 'token-1'])
    assert.deepEqual(told, [['open'], ['open'], ['again']])
    now = 2 * BEAT_MS
    for (const k of [1, 2]) here(k)
    now = 4 * BEAT_MS
    hub.beat()
    assert.deepEqual(open, ['token-1', 'token-2'])
    hub.close()
    assert.deepEqual(open, [])
    await vite.close()
  })
})

for (const [what, script, streams] of [
  ['no shared worker', () => delete globalThis.SharedWorker, 1],
  ['neither shared worker nor locks', () => { delete globalThis.SharedWorker; Object.defineProperty(navigator, 'locks', { value: undefined }) }, 3],
]) {
  describe(`a browser with ${what}`, () => {
    it(`opens ${streams} for three tabs, and none for hidden ones`, async () => {
      const pages = await tabs(3, script)
      assert.equal(front.open(EVENTS), streams)
      await pages[0].close()
      await until(() => front.open(EVENTS) === Math.min(streams, 2), 'another tab goes on')
      for (const page of pages.slice(1)) await show(page, 'hidden')
      await until(() => front.open(EVENTS) === 0, 'no stream is left')
    })
  })
}

describe('a browser whose shared worker cannot be loaded', () => {
  it('has its events by another way', async () => {
    front.does = ({ path }) => (path.startsWith('/assets/shared') ? { status: 404 } : undefined)
    await tabs(3)
    assert.ok(front.seen.some(({ path }) => path.startsWith('/assets/shared')))
    assert.equal(front.open(EVENTS), 1)
  })
})
