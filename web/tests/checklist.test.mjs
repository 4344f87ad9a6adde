/** Before a dose: what a person checks, the air, the accuracy, what follows an overdose. On an emulated bench. */
import assert from 'node:assert/strict'
import { after, before, describe, it } from 'node:test'
import { accessibilityFaults, openBrowser, openPanel, picture, unlock } from './browser.mjs'
import { startService } from './service.mjs'

let service, chromium

before(async () => {
  service = await startService('--bench', 'emulated')
  const { id } = await service.post('/v1/calibrations', { powder: 'sand', method: 'sequential', sets: 2, tolerance_deg: 5, trials_max: 60, particles: 400 })
  await service.finished(id)
  // Nothing has to move for this.
  await service.post('/v1/bench/stop', {})
  chromium = await openBrowser(service.url)
}, { timeout: 180_000 })

after(async () => {
  await chromium?.browser.close()
  await service?.stop()
  assert.deepEqual(chromium?.complaints ?? [], [])
})

describe('the form of a dose', () => {
  for (const [width, height] of [[1440, 900], [1280, 800], [390, 844]]) {
    it(`asks for the lab's checklist and takes the rest, at ${width} px`, async () => {
      const page = await chromium.tab({ viewport: { width, height } })
      await chromium.open(page, 'weighings?powder=sand')
      await unlock(page, service.token)
      await openPanel(page, 'Weigh a dose')
      const form = page.getByRole('form', { name: 'Weigh a dose', exact: true })
      const box = form.getByRole('group', { name: 'Before the dose' })
      await box.getByRole('button', { name: 'Edit the checklist' }).click()
      await box.getByLabel(/One item per line/).fill(`Glove box closed\n\nSpoon ${width} gripped\n`)
      await box.getByRole('button', { name: 'Save the checklist' }).click()
      await box.getByLabel(`Spoon ${width} gripped`).waitFor()
      await form.getByText('Air, accuracy, overdose').click()
      await form.getByLabel('Temperature (°C)').fill('21.5')
      await form.getByLabel('Relative humidity (%)').fill('43')
      await form.getByLabel('Required accuracy (%)').fill('1')
      await form.getByLabel('After an overdose').selectOption('2')
      const before = (await service.get('/v1/weighings')).total
      await form.getByRole('button', { name: 'Weigh', exact: true }).click()
      assert.equal((await service.get('/v1/weighings')).total, before, 'not before everything is ticked')
      await box.getByLabel('Glove box closed').focus()
      await page.keyboard.press('Space')
      await box.getByLabel(`Spoon ${width} gripped`).check()
      assert.deepEqual(await accessibilityFaults(page), [])
      await picture(page, `checklist-${width}`)
      await form.getByRole('button', { name: 'Weigh', exact: true }).click()
      await page.waitForURL(/#\/weighings\/./)
      const [made] = (await service.get('/v1/weighings')).items
      assert.deepEqual(made.asked, { temperature_c: 21.5, relative_humidity_pct: 43, accuracy_pct: 1, checked: ['Glove box closed', `Spoon ${width} gripped`], on_overdose: { action: 'discard_and_retry', max: 2 } })
      await page.context().close()
    })
  }

  it('asks for nothing on a simulated bench', async () => {
    const other = await startService()
    const browser = await openBrowser(other.url)
    const page = await browser.tab()
    const answers = ['bench', 'bench/checklist'].map((path) => page.waitForResponse(`**/v1/${path}`).then((answer) => answer.finished()))
    await browser.open(page, 'weighings?new=dose')
    await page.getByRole('form', { name: 'Weigh a dose', exact: true }).waitFor()
    await Promise.all(answers)
    assert.equal(await page.getByRole('group', { name: 'Before the dose' }).count(), 0)
    await browser.browser.close()
    await other.stop()
  })
})
