/** Doses on an emulated laboratory that cannot exchange vials: confirmed, stopped, held and resumed on the page. */
import assert from 'node:assert/strict'
import { after, before, describe, it } from 'node:test'
import { openBrowser, openPanel, unlock } from './browser.mjs'
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
  const form = await openPanel(page, 'Weigh a dose')
  await form.getByLabel('Powder', { exact: true }).selectOption('sand')
  await form.getByLabel('Target').fill('12')
  await form.getByLabel('Vial', { exact: true }).fill(vial)
  const checklist = form.getByRole('group', { name: 'Before the dose' })
  await checklist.waitFor()
  for (const box of await checklist.getByRole('checkbox').all()) await box.check()
  await form.getByRole('button', { name: 'Weigh' }).click()
  await page.waitForURL(/#\/weighings\/[0-9a-f-]{36}/)
  return page.url().match(/[0-9a-f-]{36}/)[0]
}
const strip = () => page.getByRole('region', { name: 'Bench now' })
const state = (word) => page.locator('.verdict .badge').getByText(word, { exact: true }).waitFor({ timeout: 60_000 })
const confirm = async (label) => {
  await page.getByLabel('Text on the vial label').fill(label)
  await page.getByRole('button', { name: /^Vial .* is in$/ }).click()
}

describe('doses for two vials in a laboratory', () => {
  it('wait until a person says that the vial is in that they name', async () => {
    await weigh('A1')
    await state('Awaiting vial')
    await page.getByRole('heading', { name: 'Insert vial A1, then confirm' }).waitFor()
    await service.post('/v1/weighings', { powder: 'sand', target: { value: 12, unit: 'mg' }, tolerance: { lower: 1, upper: 1, unit: 'mg' }, asked: { vial: 'A2' } }, { 'idempotency-key': 'second' })
    await confirm('A9')
    await page.getByRole('alert').getByText('`A9`').waitFor()
    await confirm('A1')
    await state('Dosing')
  })

  it('are stopped from the strip while the spoon shakes, and the second does not begin', async () => {
    // Half of it is in the vial.
    await page.waitForFunction(() => Number(document.querySelector('.digits')?.textContent) >= 6, undefined, { timeout: 120_000 })
    await strip().getByRole('button', { name: 'Stop', exact: true }).click()
    await strip().getByText(/^Stopped after \d+ ms$/).waitFor()
    await state('Stopped')
    await strip().getByText('nothing starts until someone resumes the bench').waitFor()
    await strip().getByText('One dose is waiting.').waitFor()
    const { moving, held, waiting } = await service.get('/v1/bench')
    assert.deepEqual([moving, !!held, waiting.map((dose) => dose.vial)], [null, true, ['A2']])
  })

  it('go on when a person resumes the bench, who sees the second', async () => {
    await strip().getByRole('button', { name: 'Resume the bench' }).click()
    await page.getByRole('list', { name: 'Waiting doses' }).getByText('12.00 mg of Sand').waitFor()
    await page.getByLabel('Your name').fill('Grace')
    await page.getByRole('button', { name: 'Resume', exact: true }).click()
    await strip().getByRole('link', { name: 'Insert vial A2, then confirm' }).click()
    await page.getByText('Last on the pan: vial A1').waitFor()
  })

  it('are not poured into the vial of the first, whatever is said', async () => {
    await confirm('A2')
    await state('Aborted')
    await page.getByText(/Nothing was poured/).waitFor()
    await page.getByRole('group', { name: 'Balance', exact: true }).getByText('no reading').waitFor()
  })
})
