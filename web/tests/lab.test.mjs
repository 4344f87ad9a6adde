/** Doses on an emulated laboratory that cannot exchange vials: confirmed, stopped, held and resumed on the page. */
import assert from 'node:assert/strict'
import { after, before, describe, it } from 'node:test'
import { openBrowser, unlock } from './browser.mjs'
import { startLab, startService } from './service.mjs'

let lab, service, chromium, page

before(async () => {
  lab = await startLab('--speed', '4')
  service = await startService('--bench', lab.file)
  const { id } = await service.post('/v1/calibrations', { powder: 'sand', method: 'sequential', sets: 2, tolerance_deg: 5, trials_max: 60, particles: 400 })
  await service.finished(id)
  chromium = await openBrowser(service.url)
  page = await chromium.tab()
}, { timeout: 900_000 })

after(async () => {
  await chromium?.browser.close()
  await service?.stop()
  await lab?.stop()
})

/** Asks for a dose on the page; its id. */
async function weigh(vial) {
  await chromium.open(page, 'weighings')
  if (!(await page.getByRole('button', { name: /Token set/ }).count())) await unlock(page, service.token)
  const form = page.getByRole('form', { name: 'Weigh a dose' })
  await form.getByLabel('Target').fill('12')
  await form.getByLabel('Vial', { exact: true }).fill(vial)
  await form.getByRole('button', { name: 'Weigh' }).click()
  await page.waitForURL(/#\/weighings\/[0-9a-f-]{36}/)
  return page.url().match(/[0-9a-f-]{36}/)[0]
}
const strip = () => page.getByRole('region', { name: 'Bench now' })
const state = (word) => page.locator('.verdict .badge').getByText(word, { exact: true }).waitFor({ timeout: 60_000 })

describe('a dose in a laboratory', () => {
  it('is stopped from the strip while the spoon shakes', async () => {
    const id = await weigh('A1')
    await state('Dosing')
    await strip().getByRole('button', { name: 'Stop', exact: true }).click()
    await strip().getByText(/^Stopped after \d+ ms$/).waitFor()
    await state('Stopped')
    assert.equal((await service.get(`/v1/weighings/${id}`)).weighing.outcome, 'stopped')
    assert.equal((await service.get('/v1/bench')).moving, null)
  })
})
