/** A person logs in with the lab's own account: to the provider and back, in a real browser. */
import assert from 'node:assert/strict'
import { createHash, generateKeyPairSync, sign } from 'node:crypto'
import { once } from 'node:events'
import { mkdtempSync, rmSync, writeFileSync } from 'node:fs'
import { createServer } from 'node:http'
import { tmpdir } from 'node:os'
import { join } from 'node:path'
import { after, before, describe, it } from 'node:test'
import { accessibilityFaults, becomes, fits, openBrowser, picture } from './browser.mjs'
import { startService } from './service.mjs'

const text = (value) => Buffer.from(value).toString('base64url')

/** A provider where whoever comes is Ada; `says` is what its next answer says instead. */
async function startProvider() {
  const { privateKey, publicKey } = generateKeyPairSync('ec', { namedCurve: 'P-256' })
  const provider = { says: {}, back: '', asked: [] }
  const codes = new Map()
  const server = createServer(async (request, answer) => {
    const { pathname, searchParams: asked } = new URL(request.url, provider.issuer)
    provider.asked.push(pathname)
    const json = (value) => answer.setHeader('content-type', 'application/json').end(JSON.stringify(value))
    if (pathname === '/authorize') {
      codes.set('a-code', { nonce: asked.get('nonce'), challenge: asked.get('code_challenge') })
      const given = provider.says.error ? `error=${provider.says.error}` : 'code=a-code'
      return answer.setHeader('content-type', 'text/html').end(`<title>Lab accounts</title><h1>Lab accounts</h1><a href="${provider.back}/?${given}&state=${asked.get('state')}">I am Ada</a>`)
    }
    if (pathname === '/jwks') return json({ keys: [{ ...publicKey.export({ format: 'jwk' }), kid: '1', use: 'sig' }] })
    if (pathname === '/token') {
      const sent = new URLSearchParams(Buffer.concat(await request.toArray()).toString())
      const { nonce, challenge } = codes.get(sent.get('code')) ?? {}
      codes.delete(sent.get('code'))
      if (createHash('sha256').update(sent.get('code_verifier')).digest('base64url') !== challenge) return answer.writeHead(400).end('{"error":"invalid_grant"}')
      const claims = { iss: provider.issuer, aud: 'flip', sub: '17', name: 'Ada', nonce, exp: Date.now() / 1000 + 300 | 0, groups: ['balance'], ...provider.says }
      const said = `${text('{"alg":"ES256","kid":"1"}')}.${text(JSON.stringify(claims))}`
      return json({ id_token: `${said}.${sign('sha256', said, { key: privateKey, dsaEncoding: 'ieee-p1363' }).toString('base64url')}` })
    }
    json({ issuer: provider.issuer, authorization_endpoint: `${provider.issuer}/authorize`, token_endpoint: `${provider.issuer}/token`, jwks_uri: `${provider.issuer}/jwks` })
  })
  server.listen(0, '127.0.0.1')
  await once(server, 'listening')
  provider.host = `localhost:${server.address().port}`
  provider.issuer = `http://${provider.host}`
  provider.stop = () => server.close()
  return provider
}

let service, chromium, provider, folder

before(async () => {
  provider = await startProvider()
  folder = mkdtempSync(join(tmpdir(), 'flip-login-'))
  const secret = join(folder, 'secret')
  writeFileSync(secret, 'a secret\n')
  // The service learns its port when it starts, so the provider is told where to send browsers afterwards.
  service = await startService('--oidc-issuer', provider.issuer, '--oidc-client-id', 'flip', '--oidc-client-secret-file', secret, '--oidc-redirect-url', 'http://127.0.0.1:1/', '--oidc-role', 'operator=balance')
  provider.back = service.url
  chromium = await openBrowser(service.url)
}, { timeout: 60_000 })

after(async () => {
  await chromium?.browser.close()
  await service?.stop()
  provider?.stop()
  rmSync(folder, { recursive: true, force: true })
  // The browser goes to the provider because a person presses a button; the page itself asks nobody else.
  const complaints = (chromium?.complaints ?? []).filter((it) => !/^asked for http:\/\/localhost:\d+\/(authorize|favicon)/.test(it))
  assert.deepEqual(complaints, [])
})

const dialog = (page) => page.getByRole('dialog')
async function toProvider(page, view) {
  await chromium.open(page, view)
  await page.getByRole('button', { name: 'Read only' }).click()
  await dialog(page).getByRole('button', { name: `Log in with ${provider.host}` }).click()
  await page.getByRole('heading', { name: 'Lab accounts' }).waitFor()
}
const addresses = (page) => page.evaluate(() => [location.href, document.referrer, ...performance.getEntriesByType('resource').map((it) => it.name)].join(' '))

describe('a log-in with the lab account', () => {
  for (const [width, height] of [[1440, 900], [390, 844]]) {
    it(`leads back to where the person was, at ${width} px`, async () => {
      provider.says = {}
      const page = await chromium.tab({ viewport: { width, height } })
      await chromium.open(page, 'bench')
      await page.getByRole('button', { name: 'Read only' }).click()
      await dialog(page).getByRole('button', { name: `Log in with ${provider.host}` }).waitFor()
      assert.deepEqual(await accessibilityFaults(page), [])
      assert.ok(await fits(page))
      await picture(page, `login-${width}`)
      await dialog(page).getByRole('button', { name: `Log in with ${provider.host}` }).focus()
      await page.keyboard.press('Enter')
      await page.getByRole('link', { name: 'I am Ada' }).click()
      await page.getByRole('button', { name: 'Token set: Ada, operator' }).waitFor()
      await becomes(() => page.evaluate(() => location.href), `${service.url}/#/bench`)
      const seen = await addresses(page)
      assert.ok(!seen.includes('a-code') && !seen.includes('flip_'), seen)
      await page.getByRole('button', { name: 'Save the check' }).waitFor()
      // Nothing is left that a reload would try again.
      await page.reload()
      await page.getByRole('button', { name: 'Token set: Ada, operator' }).click()
      await dialog(page).getByText('You are Ada, operator').waitFor()
      await page.context().close()
    })
  }

  it('without a group says so where the person logs in, and the page goes on reading', async () => {
    provider.says = { groups: ['visitors'] }
    const page = await chromium.tab()
    await toProvider(page, 'weighings')
    await page.getByRole('link', { name: 'I am Ada' }).click()
    await dialog(page).getByRole('alert').getByText(/Ada is logged in at localhost:\d+, but none of the groups there has a role here/).waitFor()
    assert.deepEqual(await accessibilityFaults(page), [])
    await picture(page, 'login-refused')
    await dialog(page).getByRole('button', { name: 'Close' }).click()
    await page.getByRole('button', { name: 'Read only' }).waitFor()
    await page.context().close()
  })

  it('that the person breaks off says so', async () => {
    provider.says = { error: 'access_denied' }
    const page = await chromium.tab()
    await toProvider(page, 'bench')
    await page.getByRole('link', { name: 'I am Ada' }).click()
    await dialog(page).getByRole('alert').getByText(/access_denied/).waitFor()
    await page.context().close()
  })

  it('that somebody else began logs nobody in', async () => {
    provider.says = {}
    const [mine, theirs] = [await chromium.tab(), await chromium.tab()]
    await toProvider(theirs, 'bench')
    const link = await theirs.getByRole('link', { name: 'I am Ada' }).getAttribute('href')
    const before = provider.asked.filter((it) => it === '/token').length
    await mine.goto(link)
    await dialog(mine).getByRole('alert').getByText(/not begun in this tab/).waitFor()
    assert.ok(!(await mine.evaluate(() => location.href)).includes('a-code'))
    assert.equal(provider.asked.filter((it) => it === '/token').length, before, 'the code was not even tried')
    await theirs.getByRole('link', { name: 'I am Ada' }).click()
    await theirs.getByRole('button', { name: 'Token set: Ada, operator' }).waitFor()
    await Promise.all([mine, theirs].map((page) => page.context().close()))
  })

  it('is offered only by a service that knows a provider', async () => {
    const plain = await startService()
    try {
      const other = await openBrowser(plain.url)
      const page = await other.tab()
      await other.open(page, 'bench')
      const told = page.waitForResponse(/\/v1\/login$/)
      await page.getByRole('button', { name: 'Read only' }).click()
      assert.deepEqual(await (await told).json(), { provider: null })
      assert.equal(await dialog(page).getByRole('button', { name: /Log in/ }).count(), 0)
      await other.browser.close()
    } finally {
      await plain.stop()
    }
  })
})
