/** The certificate of a dose and of a list: what it says, that it prints whole on A4, and what the dose's page says of a stop. */
import assert from 'node:assert/strict'
import { after, before, describe, it } from 'node:test'
import { accessibilityFaults, fits, openBrowser, picture } from './browser.mjs'
import { pagesOf } from './pdf.mjs'
import { startService } from './service.mjs'

const LABORATORY = 'Powder laboratory 7'
let service, chromium, page, id

before(async () => {
  service = await startService('--laboratory', LABORATORY)
  const run = await service.post('/v1/calibrations', { powder: 'sand', method: 'sequential', sets: 2, tolerance_deg: 5, trials_max: 60, particles: 400 })
  await service.finished(run.id)
  const dose = { powder: 'sand', target: { value: 12, unit: 'mg' }, tolerance: { lower: 1, upper: 1, unit: 'mg' }, asked: { operator: 'Ada', lot: 'L-42', vial: 'A1' } }
  id = (await service.post('/v1/weighings', dose, { 'idempotency-key': 'certified' })).id
  while (!(await service.get(`/v1/weighings/${id}`)).weighing.outcome) await new Promise((go) => setTimeout(go, 200))
  chromium = await openBrowser(service.url)
  page = await chromium.tab()
}, { timeout: 900_000 })

after(async () => {
  await chromium?.browser.close()
  await service?.stop()
})

const squeezed = (text) => text.normalize('NFKC').replaceAll(/\s+/g, '')
/** The parts of the page that must not be cut, by their headings, each with the texts in it. */
const parts = () => page.locator('.whole').evaluateAll((all) => all.map((part) => [part.querySelector('h2').textContent, [...part.querySelectorAll('h2, th, td, figcaption, svg text')].map((it) => it.textContent.trim()).filter(Boolean)]))

describe('the certificate of a dose', () => {
  it('names the laboratory and the person, draws the course, and has room to sign', async () => {
    await page.goto(`${service.url}/v1/weighings/${id}/certificate.html`)
    await page.getByText(LABORATORY, { exact: true }).waitFor()
    await page.getByRole('img', { name: /^Balance readings from -?[\d.]+ mg to [\d.]+ mg in \d+ s; the target is 12 mg\.$/ }).waitFor()
    await page.getByText('Simulated: no real powder was weighed.').waitFor()
    const signed = page.locator('table.signed')
    assert.deepEqual(await signed.locator('thead th').allTextContents(), ['Role', 'Name', 'Signature', 'Date'])
    assert.deepEqual(await signed.locator('tbody tr').evaluateAll((rows) => rows.map((row) => [...row.cells].map((cell) => cell.textContent))), [['Operator', 'Ada', '', ''], ['Reviewer', '', '', '']])
    const ticks = (await service.get(`/v1/weighings/${id}`)).ticks
    assert.equal((await page.locator('path.mass').getAttribute('d')).split('V').length, ticks.length, 'a step for every reading')
  })

  for (const width of [1440, 1280, 390]) {
    it(`fits a window of ${width} px, and axe finds nothing`, async () => {
      await page.setViewportSize({ width, height: 900 })
      assert.ok(await fits(page))
      assert.deepEqual(await accessibilityFaults(page), [])
      await picture(page, `certificate-${width}`)
    })
  }

  it('prints on A4 without loss: every text, no part cut, the curve, and the word across every sheet', async () => {
    const sheets = await pagesOf(await page.pdf({ format: 'A4', printBackground: false }))
    assert.ok(sheets.length >= 1 && sheets.length <= 3, `${sheets.length} sheets`)
    for (const sheet of sheets) {
      // A4 in points, as Chromium rounds it.
      assert.ok(Math.abs(sheet.width - 595.3) < 1.5 && Math.abs(sheet.height - 841.9) < 1.5, `${sheet.width} × ${sheet.height}`)
      assert.match(squeezed(sheet.text), /SIMULATED/)
    }
    for (const [name, texts] of await parts()) {
      const whole = sheets.filter((sheet) => texts.every((text) => squeezed(sheet.text).includes(squeezed(text))))
      const missing = sheets.map((sheet) => texts.filter((text) => !squeezed(sheet.text).includes(squeezed(text))))
      assert.equal(whole.length, 1, `${name} stands on one sheet; missing on each: ${JSON.stringify(missing)}`)
    }
    // Only the curve is drawn in this colour.
    assert.equal(sheets.filter((sheet) => sheet.lines.includes('#1c3fae')).length, 1)
  })
})

describe('the certificate of a list', () => {
  it('prints with a heading on every sheet and no row cut', async () => {
    const rows = Array.from({ length: 40 }, (_, k) => `A${k + 1},V-${k + 1},sand,6`)
    const table = ['position,vial,powder,target_mg', ...rows].join('\n')
    await service.post('/v1/weighings/list', { name: 'Plate 9', table, tolerance: { lower: 2, upper: 2, unit: 'mg' }, operator: 'Ada' }, { 'idempotency-key': 'plate-9' })
    // What waits needs no dose to be certified.
    const { items } = await service.get('/v1/weighings?list=Plate%209&limit=200')
    for (const dose of items) await service.post(`/v1/weighings/${dose.id}/stop`).catch(() => undefined)
    for (;;) {
      const all = (await service.get('/v1/weighings?list=Plate%209&limit=200')).items
      if (all.every((dose) => dose.outcome)) break
      await new Promise((go) => setTimeout(go, 300))
    }
    await page.goto(`${service.url}/v1/weighings/certificate.html?list=Plate+9`)
    const sheets = await pagesOf(await page.pdf({ format: 'A4' }))
    assert.ok(sheets.length > 1)
    const text = squeezed(sheets.map((sheet) => sheet.text).join(''))
    for (let k = 1; k <= 40; k++) assert.ok(text.includes(`A${k}V-${k}`), `row ${k}`)
    assert.ok(sheets.every((sheet) => /SIMULATED/.test(squeezed(sheet.text))))
    assert.deepEqual(await accessibilityFaults(page), [])
  })
})

describe('a dose that was stopped', () => {
  it('says on its page and on its certificate by whom and when', async () => {
    const stopped = (await service.get('/v1/weighings?list=Plate%209&outcome=stopped&limit=1')).items[0]
    await chromium.open(page, `weighings/${stopped.id}`)
    const fact = page.locator('dl.facts div', { has: page.getByText('Stopped', { exact: true }) })
    await fact.getByText('first start').waitFor()
    await fact.locator('time').waitFor()
    await page.goto(`${service.url}/v1/weighings/${stopped.id}/certificate.html`)
    await page.getByRole('row', { name: /^Stopped by first start \(admin\), 20/ }).waitFor()
    assert.deepEqual(chromium.complaints, [])
  })
})
