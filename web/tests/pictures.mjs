/** The pictures of the README and the documentation, of the page as it is: `make pictures` begins a service with an emulated bench, lets it calibrate, weigh and investigate, and writes docs/pictures. */
import { readFileSync } from 'node:fs'
import { fileURLToPath } from 'node:url'
import { openBrowser, unlock } from './browser.mjs'
import { startService } from './service.mjs'

const FOLDER = fileURLToPath(new URL('../../docs/pictures/', import.meta.url))
const CAMPAIGN = readFileSync(fileURLToPath(new URL('../../examples/campaigns/humidity.csv', import.meta.url)), 'utf8')
const WIDTH = 1280

const service = await startService('--bench', 'emulated', '--seed', '1')
const chromium = await openBrowser(service.url)
const page = await chromium.tab({ viewport: { width: WIDTH, height: 800 }, colorScheme: 'light' })

let dose = 0
const weigh = (target, lot) => {
  dose += 1
  const asked = { lot, vial: `V-${dose}`, operator: 'M. Keller', temperature_c: 21.4, relative_humidity_pct: 41 }
  return service.post('/v1/weighings', { powder: 'salt', target: { value: target, unit: 'mg' }, tolerance: { lower: 1, upper: 1, unit: 'mg' }, asked }, { 'idempotency-key': `picture-${dose}` })
}
/** The weighing once it has ended. */
async function ended(id) {
  for (;;) {
    const { weighing } = await service.get(`/v1/weighings/${id}`)
    if (weighing.finished_at) return weighing
    await new Promise((resolve) => setTimeout(resolve, 300))
  }
}
/** Keeps what is seen from the top of the page down to this element's end, at most so many pixels high. */
async function keep(name, last, most = 1000) {
  await page.evaluate(() => document.fonts.ready)
  const bottom = last ? await last.evaluate((element) => element.getBoundingClientRect().bottom + scrollY) : Infinity
  await page.screenshot({ path: `${FOLDER}${name}.png`, fullPage: true, clip: { x: 0, y: 0, width: WIDTH, height: Math.ceil(Math.min(most, bottom + 24)) } })
  console.log(`docs/pictures/${name}.png`)
}
/** Keeps one section. */
async function keepSection(name, section) {
  await section.scrollIntoViewIfNeeded()
  await page.evaluate(() => document.fonts.ready)
  await section.screenshot({ path: `${FOLDER}${name}.png` })
  console.log(`docs/pictures/${name}.png`)
}

await chromium.open(page)
await unlock(page, service.token)
const calibrations = []
for (const seed of [1, 2]) calibrations.push(await service.post('/v1/calibrations', { powder: 'salt', method: 'sequential', sets: 4, seed }))
for (const { id } of calibrations) await service.finished(id)
const investigation = await service.post('/v1/investigations', { measurements_csv: CAMPAIGN, seed: 1 })

const doses = []
for (const target of [10, 15, 12, 20]) doses.push(await ended((await weigh(target, 'L3')).id))
const moving = await weigh(18, 'L4')
await weigh(9, 'L4')
await chromium.open(page)
await page.waitForFunction(() => Number(document.querySelector('main [role=meter]')?.getAttribute('aria-valuenow')) > 4, undefined, { timeout: 120_000 })
await keep('console')
await ended(moving.id)

const film = await service.post('/v1/films', { weighing: doses[1].id, spoonful: 1 })
await service.finished(film.id)
await page.emulateMedia({ reducedMotion: 'reduce' })
await chromium.open(page, `weighings/${doses[1].id}`)
const powder = page.locator('section', { has: page.getByRole('heading', { name: 'The powder' }) })
await powder.getByRole('button', { name: 'Show the grains' }).click()
await powder.getByRole('button', { name: 'Play' }).waitFor()
await powder.getByRole('slider', { name: 'Simulated time' }).evaluate((slider) => {
  slider.value = String(0.6 * Number(slider.max))
  slider.dispatchEvent(new Event('input', { bubbles: true }))
})
await keepSection('grains', powder.locator('.player'))

await chromium.open(page, 'weighings')
await page.locator('table tbody tr').first().waitFor()
await keep('weighings')

await chromium.open(page, 'powders/salt')
await page.locator('table tbody tr').first().waitFor()
await keep('powder')

await chromium.open(page, `compare/calibrations?ids=${calibrations.map(({ id }) => id).join(',')}`)
await page.locator('svg').first().waitFor()
await keep('compare')

await service.finished(investigation.id, 900)
await chromium.open(page, `investigations/${investigation.id}`)
// The badge stands there before the report has arrived.
await page.getByRole('heading', { name: 'How well each cause explains the data' }).waitFor()
await keep('investigation')

await chromium.browser.close()
await service.stop()
