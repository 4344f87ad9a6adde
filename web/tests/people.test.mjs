/** Tokens are created and revoked on the page, by an admin, and the page says who one is. */
import assert from 'node:assert/strict'
import { after, before, describe, it } from 'node:test'
import { accessibilityFaults, openBrowser, picture, unlock } from './browser.mjs'
import { startService } from './service.mjs'

let service, chromium

before(async () => {
  service = await startService()
  chromium = await openBrowser(service.url)
}, { timeout: 60_000 })

after(async () => {
  await chromium?.browser.close()
  await service?.stop()
  assert.deepEqual(chromium?.complaints ?? [], [])
})

describe('people', () => {
  for (const [width, height] of [[1440, 900], [1280, 800], [390, 844]]) {
    it(`get tokens and lose them, at ${width} px`, async () => {
      const page = await chromium.tab({ viewport: { width, height } })
      await chromium.open(page, 'people')
      await page.getByText('Only an admin sees and changes tokens.').waitFor()
      await unlock(page, service.token)
      const form = page.getByRole('form', { name: 'New token' })
      const name = `Ada ${width}`
      await form.getByLabel('Name').fill(name)
      await form.getByLabel('Role').selectOption('operator')
      await form.getByLabel('May clear a latched bench').check()
      await form.getByLabel('Valid').selectOption('30')
      await page.keyboard.press('Tab')
      await form.getByRole('button', { name: 'Create the token' }).click()
      const secret = await page.locator('.secret code').textContent()
      const me = await (await fetch(`${service.url}/v1/me`, { headers: { authorization: `Bearer ${secret}` } })).json()
      assert.deepEqual([me.name, me.role, me.may_clear], [name, 'operator', true])
      const days = (Date.parse(me.expires_at) - Date.now()) / 86_400_000
      assert.ok(days > 29.9 && days <= 30, `${days}`)
      assert.deepEqual(await accessibilityFaults(page), [])
      await picture(page, `people-${width}`)
      const row = page.getByRole('row', { name: new RegExp(name) })
      await row.getByRole('button', { name: /^Revoke/ }).focus()
      await page.keyboard.press('Enter')
      await row.getByRole('button', { name: `Revoke ${name}` }).click()
      await page.getByText(`The token of ${name} is revoked`).waitFor()
      assert.equal((await fetch(`${service.url}/v1/me`, { headers: { authorization: `Bearer ${secret}` } })).status, 401)
      await row.getByText('Revoked').waitFor()
      await page.context().close()
    })
  }

  it('see their name, and may keep a token in the browser', async () => {
    const { secret } = await service.post('/v1/tokens', { name: 'Bo', role: 'operator' })
    const page = await chromium.tab()
    await chromium.open(page, 'bench')
    await page.getByRole('button', { name: 'Read only' }).click()
    await page.getByRole('dialog').getByLabel('Token').fill(secret)
    await page.getByRole('dialog').getByLabel(/Keep it in this browser/).check()
    await page.getByRole('button', { name: 'Use this token' }).click()
    const mine = page.getByRole('button', { name: 'Token set: Bo, operator' })
    await mine.waitFor()
    const other = await chromium.beside(page.context())
    await chromium.open(other, 'bench')
    await other.getByRole('button', { name: 'Token set: Bo, operator' }).click()
    await other.getByText('You are Bo, operator').waitFor()
    assert.equal(await other.getByRole('link', { name: 'Create and revoke tokens' }).count(), 0, 'an operator is no admin')
    await other.getByRole('button', { name: 'Forget the token' }).click()
    await page.reload()
    await page.getByRole('button', { name: 'Read only' }).waitFor()
  })
})
