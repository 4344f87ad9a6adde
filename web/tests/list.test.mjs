/** A list of doses pasted from a spreadsheet: checked, weighed in order, found, certified, and one of them again. */
import assert from 'node:assert/strict'
import { after, before, describe, it } from 'node:test'
import { accessibilityFaults, becomes, fits, openBrowser, openPanel, picture, unlock } from './browser.mjs'
import { startService } from './service.mjs'

let service, chromium, page

before(async () => {
  service = await startService()
  const { id } = await service.post('/v1/calibrations', { powder: 'sand', method: 'sequential', sets: 2, tolerance_deg: 5, trials_max: 60, particles: 400 })
  await service.finished(id)
  chromium = await openBrowser(service.url)
  page = await chromium.tab()
}, { timeout: 900_000 })

after(async () => {
  await chromium?.browser.close()
  await service?.stop()
})

const form = () => page.getByRole('form', { name: 'Weigh a list of doses' })
const GOOD = 'Substance\tMass [mg]\tWell\tVial\nSand\t12\tA1\tV-1\nSand\t8,5\tA2\tV-2'
async function opened(width = 1440) {
  await page.setViewportSize({ width, height: 900 })
  await chromium.open(page, 'weighings')
  if (!(await page.getByRole('button', { name: /Token set/ }).count())) await unlock(page, service.token)
  await openPanel(page, 'Weigh a list of doses')
}
async function filled(name, table) {
  await form().getByLabel('Name of the list').fill(name)
  await form().getByLabel('Doses', { exact: true }).fill(table)
}

describe('a list of doses', () => {
  it('names every wrong row by its row and column, and stores nothing', async () => {
    await opened()
    await filled('Plate 1', GOOD.replace('8,5', '-2').replace('12', ''))
    await form().getByRole('button', { name: 'Check the list' }).click()
    const alert = form().getByRole('alert')
    await alert.getByText('row[2].target_mg').waitFor()
    await alert.getByText('row[3].target_mg').waitFor()
    assert.equal((await service.get('/v1/weighings')).total, 0)
    assert.deepEqual(await accessibilityFaults(page), [])
  })

  it('offers the calibration that a powder of its rows lacks, once', async () => {
    await opened()
    await filled('Plate 1', GOOD.replaceAll('Sand', 'Salt'))
    await form().getByRole('button', { name: 'Check the list' }).click()
    const alert = form().getByRole('alert')
    await alert.getByText('row[3].powder').waitFor()
    assert.match(await alert.getByRole('link', { name: 'Calibrate Salt' }).getAttribute('href'), /#\/powders\/salt\?calibrate=yes$/)
    assert.deepEqual(await accessibilityFaults(page), [])
  })

  it('is checked, then weighed in order by the keyboard alone', async () => {
    await opened(1280)
    await filled('Plate 1', GOOD)
    await form().getByRole('button', { name: 'Check the list' }).press('Enter')
    const checked = page.getByRole('form', { name: 'Checked list' })
    await checked.getByRole('row', { name: /A2 V-2 Sand – 8\.50/ }).waitFor()
    assert.deepEqual(await accessibilityFaults(page), [])
    // The button has the focus; a change of the table takes it away.
    await becomes(() => page.evaluate(() => document.activeElement?.textContent?.trim()), 'Weigh these 2 doses')
    await form().getByLabel('Operator').fill('Ada')
    await checked.waitFor({ state: 'detached' })
    await form().getByRole('button', { name: 'Check the list' }).press('Enter')
    await page.getByRole('button', { name: 'Weigh these 2 doses' }).press('Enter')
    await page.waitForURL(/#\/weighings\?list=Plate/)
    await page.getByText('2 match').waitFor()
    await page.getByText('2 doses of the list Plate 1 will be weighed').waitFor()
    await becomes(() => page.locator('dialog[open]').count(), 0)
    const { items } = await service.get('/v1/weighings?list=Plate%201&sort=oldest')
    assert.deepEqual(items.map((w) => [w.asked.position, w.asked.vial, w.asked.operator, w.target_mg]), [['A1', 'V-1', 'Ada', 12], ['A2', 'V-2', 'Ada', 8.5]])
  })

  it('has one certificate once all its doses have ended', async () => {
    for (;;) {
      const { items } = await service.get('/v1/weighings?list=Plate%201')
      if (items.every((w) => w.outcome)) break
      await new Promise((go) => setTimeout(go, 300))
    }
    const link = page.getByRole('link', { name: 'Certificate of the list' })
    const [sheet] = await Promise.all([page.context().waitForEvent('page'), link.click()])
    await sheet.getByRole('heading', { name: 'Certificate of a list of doses' }).waitFor()
    await sheet.getByRole('cell', { name: 'V-2' }).waitFor()
    await sheet.getByText('no real powder was weighed').waitFor()
    await sheet.close()
  })

  it('offers any of its doses again, without its vial', async () => {
    await page.getByRole('table', { name: 'Weighings' }).getByRole('link', { name: 'Sand' }).first().click()
    await page.getByRole('link', { name: 'Weigh again' }).click()
    const again = page.getByRole('form', { name: 'Weigh a dose' })
    await again.getByLabel('Operator').waitFor()
    await page.waitForFunction(() => document.querySelector('form[aria-label="Weigh a dose"] input[type=number]')?.value === '12')
    await becomes(() => again.getByLabel('Operator').inputValue(), 'Ada')
    assert.equal(await again.getByLabel('Vial', { exact: true }).inputValue(), '')
  })

  it('fits a phone', async () => {
    await opened(390)
    await filled('Plate 2', GOOD)
    await form().getByRole('button', { name: 'Check the list' }).click()
    await page.getByRole('button', { name: 'Weigh these 2 doses' }).waitFor()
    assert.ok(await fits(page))
    assert.deepEqual(await accessibilityFaults(page), [])
    await picture(page, 'list-phone')
    assert.deepEqual(chromium.complaints, [])
  })
})
