/** A token is checked when it is entered, and the page says what it may. */
import assert from 'node:assert/strict'
import { after, before, describe, it } from 'node:test'
import { accessibilityFaults, becomes, openBrowser, picture, unlock } from './browser.mjs'
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

const dialog = () => page.getByRole('dialog')
const enter = async (token) => {
  await page.getByRole('button', { name: /Read only|Token set/ }).click()
  await dialog().getByLabel('Token').fill(token)
  await dialog().getByRole('button', { name: 'Use this token' }).click()
}

describe('a token that the service does not know', () => {
  it('is refused in the dialog, and the page goes on reading', async () => {
    await chromium.open(page, 'bench')
    await enter('flip_0000000000000000_wrong')
    await dialog().getByRole('alert').getByText(/the token is unknown/).waitFor()
    await picture(page, 'token-refused')
    assert.deepEqual(await accessibilityFaults(page), [])
    await dialog().getByRole('button', { name: 'Close' }).click()
    await page.getByRole('button', { name: 'Read only' }).waitFor()
    await page.getByText('Live', { exact: true }).waitFor()
    await page.reload()
    await page.getByRole('button', { name: 'Read only' }).waitFor()
  })

  it('does not take the place of one that it knows', async () => {
    await chromium.open(page, 'bench')
    await unlock(page, service.token)
    await enter('flip_0000000000000000_wrong')
    await dialog().getByRole('alert').waitFor()
    await dialog().getByRole('button', { name: 'Close' }).click()
    await page.getByRole('button', { name: /Token set/ }).waitFor()
    await page.getByRole('button', { name: 'Save the check' }).waitFor()
  })
})

describe('a token that the service knows', () => {
  for (const [role, may] of [['viewer', /can read, but not start or stop anything/], ['operator', /can start, stop and add things/], ['admin', /can do everything/]]) {
    it(`of role ${role} is named so, and may what it may`, async () => {
      const { secret } = await service.post('/v1/tokens', { name: `a ${role}`, role })
      const tab = await chromium.tab()
      await chromium.open(tab, 'bench')
      await unlock(tab, secret)
      const set = tab.getByRole('button', { name: `Token set: a ${role}, ${role}` })
      await set.click()
      await tab.getByRole('dialog').getByRole('status').getByText(may).waitFor()
      assert.deepEqual(await accessibilityFaults(tab), [])
      await picture(tab, `token-${role}`)
      await tab.getByRole('button', { name: 'Close' }).click()
      const [save, enter] = ['Save the check', 'This token is read-only: enter another'].map((name) => tab.getByRole('button', { name }))
      await becomes(async () => [await save.count(), await enter.count()], role === 'viewer' ? [0, 1] : [1, 0])
      await tab.reload()
      await set.waitFor()
      await tab.context().close()
    })
  }
})
