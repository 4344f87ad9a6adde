/** Angles of repose by camera, on an emulated stand, in a real Chromium before a real `flip serve`. */
import assert from 'node:assert/strict'
import { after, before, describe, it } from 'node:test'
import { accessibilityFaults, openBrowser, picture, tableCells, unlock } from './browser.mjs'
import { startService } from './service.mjs'

let service, chromium, page, measured

before(async () => {
  service = await startService('--bench', 'emulated')
  const { id } = await service.post('/v1/calibrations', { powder: 'sand', method: 'sequential', sets: 2, tolerance_deg: 5, trials_max: 60, particles: 400 })
  await service.finished(id)
  const job = await service.post('/v1/repose-measurements', { powder: 'sand', procedure: { repeats: 2, open_s: 2, rest_s: 1 } })
  await service.finished(job.id)
  measured = await service.get(`/v1/repose-measurements/${job.id}`)
  chromium = await openBrowser(service.url)
  page = await chromium.tab()
}, { timeout: 900_000 })

after(async () => {
  await chromium?.browser.close()
  await service?.stop()
})

describe('an angle of repose by camera', () => {
  it('has its piles, their uncertainties and their frames on a page of its own', async () => {
    await chromium.open(page, `reposes/${measured.job.id}`)
    await page.getByRole('heading', { name: 'Angle of repose by camera, Sand, run 1', level: 1 }).waitFor()
    const piles = page.getByRole('table', { name: 'Piles', exact: true })
    await piles.waitFor()
    const [, ...rows] = await tableCells(piles)
    assert.equal(rows.length, 2)
    for (const [k, row] of rows.entries()) assert.equal(row[1], measured.piles[k].measured.tip.deg.toFixed(2))
    await page.getByText('no: the bench is emulated').waitFor()
    const frame = page.getByRole('img', { name: 'Pile 1 as the camera saw it' })
    await frame.scrollIntoViewIfNeeded()
    await page.waitForFunction((image) => image.naturalWidth === 848, await frame.elementHandle())
    assert.deepEqual(await accessibilityFaults(page), [])
    await picture(page, 'repose')
  })

  it('is asked for on the powder’s page, and cancelled', async () => {
    await chromium.open(page, 'powders/sand')
    await unlock(page, service.token)
    const table = page.getByRole('table', { name: 'By camera', exact: true })
    await table.waitFor()
    assert.equal((await tableCells(table)).length, 2)
    await page.getByRole('button', { name: 'Measure by camera' }).click()
    await page.getByRole('heading', { name: 'Angle of repose by camera, Sand, run 2', level: 1 }).waitFor()
    await page.getByRole('button', { name: /Cancel/ }).click()
    await page.locator('main .badge').getByText('Cancelled').waitFor({ timeout: 60_000 })
  })
})
