/** Angles of repose by camera, on an emulated stand, in a real Chromium before a real `flip serve`. */
import assert from 'node:assert/strict'
import { after, before, describe, it } from 'node:test'
import { accessibilityFaults, becomes, openBrowser, openPanel, picture, tableCells, unlock } from './browser.mjs'
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
    await becomes(async () => (await tableCells(piles)).slice(1).map((row) => row[1]), [0, 1].map((k) => measured.piles[k].measured.tip.deg.toFixed(2)))
    await page.getByText('no: the bench is emulated').waitFor()
    const frame = page.getByRole('img', { name: 'Pile 1 as the camera saw it' })
    await frame.scrollIntoViewIfNeeded()
    await page.waitForFunction((image) => image.naturalWidth === 848, await frame.elementHandle())
    // The fit lies on the frame as the camera gave it: the apex in the table is that of the service.
    await page.getByRole('img', { name: /^The fit over pile 1/ }).waitFor()
    await becomes(async () => (await tableCells(page.getByRole('table', { name: 'Where the parts are' })))[2], ['Apex', ...measured.piles[0].outline.apex.map((pixel) => pixel.toFixed(1))])
    assert.deepEqual(await accessibilityFaults(page), [])
    await picture(page, 'repose')
  })

  it('stands beside a heap that the simulator pours of a calibrated set', async () => {
    await chromium.open(page, 'powders/sand')
    await unlock(page, service.token)
    const section = page.locator('section', { has: page.getByRole('heading', { name: 'Measured and simulated heap' }) })
    await section.getByRole('button', { name: 'Show the heap' }).click()
    await section.locator('canvas').waitFor({ timeout: 120_000 })
    const [film] = (await service.get('/v1/films')).items
    const { tip_deg } = film.result.heap
    const apex = async () => (await tableCells(section.getByRole('table', { name: 'Measured and simulated angles' })))[1]
    const { deg } = measured.piles[0].measured.tip
    await becomes(async () => (([, seen, , poured, differs]) => [seen, poured, Number(differs)])(await apex()), [deg.toFixed(2), tip_deg.toFixed(2), Number((tip_deg - deg).toFixed(2))])
    await picture(page, 'heaps-real')
  })

  it('is asked for on the powder’s page, and cancelled', async () => {
    await chromium.open(page, 'powders/sand')
    const table = page.getByRole('table', { name: 'By camera', exact: true })
    await table.waitFor()
    await becomes(async () => (await tableCells(table)).length, 2)
    const form = await openPanel(page, 'Measure by camera')
    await form.getByLabel('Piles').fill('3')
    await form.getByRole('button', { name: 'Start the measurement' }).click()
    await page.getByRole('heading', { name: 'Angle of repose by camera, Sand, run 2', level: 1 }).waitFor()
    await page.getByRole('button', { name: /Cancel/ }).click()
    await page.locator('main .badge').getByText('Cancelled').waitFor({ timeout: 60_000 })
  })
})
