/** A pile with the lines of its fit, and beside it a simulated heap: how the file is read, and how the page shows both. */
import assert from 'node:assert/strict'
import { after, before, describe, it } from 'node:test'
import { fileURLToPath } from 'node:url'
import { createServer } from 'vite'
import { accessibilityFaults, becomes, csvOf, fits, holds, openBrowser, picture, unlock } from './browser.mjs'
import { startService } from './service.mjs'

/** Height of a grain that lies on a cone of 35 degrees on a base of 2.5 mm. */
const SLOPE = Math.tan((35 * Math.PI) / 180)
const RADIUS = 2.5
const GRAIN = 0.25
const lying = (r) => Math.max(GRAIN / 2, SLOPE * (RADIUS - r) - GRAIN / 2)
/** A heap of grains on circles, and one that falls off its base. */
const GRAINS = Array.from({ length: 11 }, (_, ring) => {
  const r = ring * GRAIN
  const n = Math.max(1, Math.floor((2 * Math.PI * r) / GRAIN))
  const columns = Array.from({ length: n }, (_, k) => [r * Math.cos((2 * Math.PI * k) / n), r * Math.sin((2 * Math.PI * k) / n)])
  return columns.flatMap(([x, y]) => Array.from({ length: Math.max(1, Math.round(lying(r) / GRAIN)) }, (_, up) => [x, y, GRAIN * (up + 0.5)]))
}).flat()
const LOST = GRAINS.length
const rings = Array.from({ length: 12 }, (_, sector) => [0.9, 1.2, 1.5].map((radius_mm) => ({ sector, radius_mm, height_mm: SLOPE * (RADIUS - radius_mm) }))).flat()
const HEAD = {
  simulator: 'pbd-3', grains: LOST + 1, frames: 3, falls: 1, grain_mm: GRAIN, every_s: 0.5, duration_s: 1, base_radius_mm: RADIUS, on_base: LOST,
  tip_deg: 35, cone_deg: 34.5, height_mm: SLOPE * RADIUS, cone_height_mm: Math.tan((34.5 * Math.PI) / 180) * RADIUS, rings,
}
const steps = (mm) => Math.round(mm * 100)
const half = Math.floor(LOST / 2)
const moved = (from, to) => GRAINS.slice(from, to).map((at, k) => [from + k, ...at.map(steps)])
const FRAMES = [
  { at: 0, moved: moved(0, half) },
  { at: 0.5, moved: [...moved(half, LOST), [LOST, steps(RADIUS), 0, 20]] },
  { at: 1, moved: [] },
]
const FALLS = [{ id: LOST, at: 0.55, from: [RADIUS, 0, 0.1], speed: [100, 0, 0] }]

function file() {
  const text = new TextEncoder().encode(JSON.stringify(HEAD))
  const bytes = []
  const put = (size, write) => {
    const view = new DataView(new ArrayBuffer(size))
    write(view)
    bytes.push(...new Uint8Array(view.buffer))
  }
  const [u16, i16, u32, f32] = [(v) => put(2, (d) => d.setUint16(0, v, true)), (v) => put(2, (d) => d.setInt16(0, v, true)), (v) => put(4, (d) => d.setUint32(0, v, true)), (v) => put(4, (d) => d.setFloat32(0, v, true))]
  bytes.push(...new TextEncoder().encode('FLIPFILM'))
  u32(1)
  u32(text.length)
  bytes.push(...text)
  for (let k = 0; k < HEAD.grains; k++) u16(125)
  for (const fall of FALLS) {
    u16(fall.id)
    u16(0)
    for (const number of [fall.at, ...fall.from, ...fall.speed]) f32(number)
  }
  for (const frame of FRAMES) {
    for (const number of [frame.at, 0, 0]) f32(number)
    u32(frame.moved.length)
    for (const [id, ...at] of frame.moved) {
      u16(id)
      at.forEach(i16)
    }
  }
  return Uint8Array.from(bytes)
}

describe('the film of a heap', () => {
  let vite, film, moment, drawing
  before(async () => {
    vite = await createServer({ root: fileURLToPath(new URL('..', import.meta.url)), server: { middlewareMode: true, ws: false, watch: null }, appType: 'custom', logLevel: 'error' })
    ;[film, moment, drawing] = await Promise.all(['file', 'moment', 'draw'].map((name) => vite.ssrLoadModule(`/src/film/${name}.ts`)))
  })
  after(() => vite.close())

  it('has each grain from when it was first seen, until it has fallen out of the picture', () => {
    const reel = new moment.Reel(film.readFilm(file().buffer))
    const counts = [0, 0.5, 0.56, 1].map((at) => reel.at(at).count)
    assert.deepEqual(counts, [half, LOST + 1, LOST + 1, LOST])
    assert.equal(reel.duration, 1)
    assert.equal(reel.at(1).vial_mg, 0)
  })

  it('is drawn with its base at the same part of the width as that of a pile, and its fit only if asked', () => {
    const reel = new moment.Reel(film.readFilm(file().buffer))
    const view = drawing.fitHeap(HEAD, 600)
    assert.ok(Math.abs((view.x(RADIUS) - view.x(-RADIUS)) * drawing.AROUND - 600) < 1e-6)
    const arcs = (fitted) => {
      let drawn = 0
      const ctx = new Proxy({}, { get: (_, name) => (name === 'arc' ? () => drawn++ : () => undefined), set: () => true })
      drawing.drawHeap(ctx, reel.at(1), HEAD, view, { grains: ['a'] }, fitted)
      return drawn
    }
    assert.equal(arcs(false), LOST)
    // One mark for each ring, and one for the apex.
    assert.equal(arcs(true), LOST + rings.length + 1)
  })
})

describe('on the page of a powder', () => {
  const RUN = '01930000-0000-7000-8000-0000000000a1'
  const JOB = '01930000-0000-7000-8000-0000000000f2'
  const SET = 'ps-0123456789abcdef'
  const circle = (x, y, r, flat) => Array.from({ length: 36 }, (_, k) => [x + r * Math.cos((k * Math.PI) / 18), y + flat * r * Math.sin((k * Math.PI) / 18)])
  const outline = {
    size: [848, 480], tip: [424, 120], apex: [424, 230], base: [[304, 310], [544, 310]], rim: circle(424, 310, 120, 0.5),
    cone: [[300, 290], [424, 224], [548, 290]], flank: [circle(424, 300, 96, 0.5), circle(424, 246, 24, 0.5)], points: Array.from({ length: 200 }, (_, k) => [360 + (k % 20) * 6, 270 + Math.floor(k / 20) * 6]),
  }
  const angle = (deg, u_deg) => ({ deg, u_deg, u_frames_deg: 0.02 })
  const measured = { tip: angle(33.4, 0.41), cone: angle(32.9, 0.22), height_mm: 20, tip_to_apex_mm: 40, tip_height_seen_mm: 60, off_centre_mm: 0.2, elevation_deg: 30, roll_deg: 0.1, flank_pixels: 4321, pile_invalid: 0.01, frames: 10 }
  const frame = { depth: 'a', colour: 'b', description: 'c' }
  const piles = [
    { number: 1, at: '2026-01-02T03:04:05Z', measured, refusal: null, frames: [frame], outline },
    { number: 2, at: '2026-01-02T03:05:05Z', measured: null, refusal: 'no bench found', frames: [frame] },
  ]
  const done = (kind, id) => ({ id, kind, state: 'succeeded', progress: { fraction: 1, message: '' }, attempts: 1, cancelling: false, created_at: '2026-01-02T03:06:05Z', started_at: '2026-01-02T03:06:05Z', finished_at: '2026-01-02T03:06:09Z', error: null })
  const flowability = (repose_deg) => ({ repose_deg, sd_deg: 0.3, n: 1 })
  const run = {
    job: done('repose', RUN), powder: 'sand', run: 1, bench: 'devices', procedure: { repeats: 1, frames: 10, open_s: 20, rest_s: 5 }, rig: { tip_height_mm: 60, base_diameter_mm: 60 }, limits: {}, piles: [],
    result: { repeats: { tip: flowability(33.4), cone: flowability(32.9), tip_u_deg: 0.41, cone_u_deg: 0.22 }, registered: true },
  }
  const made = { job: done('film', JOB), weighing: null, spoonful: null, bench: null, set: SET, seed: 1, result: { sha256: 'ab', size_bytes: 300, head: null, heap: HEAD } }
  const PNG = Buffer.from('iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mM4c+bMfwAICgNx5Z1kZQAAAABJRU5ErkJggg==', 'base64')

  let service, chromium, page, items
  before(async () => {
    service = await startService()
    chromium = await openBrowser(service.url)
    page = await chromium.tab()
    const powder = await service.get('/v1/powders/sand')
    const parameters = { particle_diameter_mm: 0.25, adhesion: 0, particle_adhesion_scale: 0, adhesion_offset_scale: 0, friction: 0.5, gravity_scale: 1, damping: 0, cohesion: 0, particle_mass_ug: 14 }
    const set = { id: SET, powder: 'sand', calibration: RUN, parameters, repose_deg: 33.9, repose_sd_deg: 0.5, runs: 8, error_deg: 0.1, created_at: '2026-01-02T03:04:05Z' }
    await page.route('**/v1/powders/sand', (route) => route.fulfill({ json: { ...powder, sets: [set] } }))
    await page.route(/\/v1\/repose-measurements(\?|$)/, (route) => route.fulfill({ json: { items: [run] } }))
    await page.route(`**/v1/repose-measurements/${RUN}`, (route) => route.fulfill({ json: { ...run, piles } }))
    await page.route(/\/frames\/1\/colour/, (route) => route.fulfill({ body: PNG, contentType: 'image/png' }))
    await page.route(/\/v1\/films\?/, (route) => route.fulfill({ json: { items } }))
    await page.route(`**/v1/films/${JOB}/grains`, (route) => route.fulfill({ body: Buffer.from(file()), contentType: 'application/octet-stream' }))
  }, { timeout: 60_000 })
  after(async () => {
    await chromium?.browser.close()
    await service?.stop()
  })
  const section = () => page.locator('section', { has: page.getByRole('heading', { name: 'Measured and simulated heap' }) })
  const angles = async () => (await csvOf(page, 'Measured and simulated angles')).rows.slice(1)

  it('the pile stands at once with its angle, and the heap is made for who may write', async () => {
    items = []
    await chromium.open(page, 'powders/sand')
    await section().getByRole('img', { name: 'Pile 1 as the camera saw it' }).waitFor()
    await becomes(async () => (await angles())[0], ['Apex, this pair', '33.40', '0.41', '', ''])
    await section().getByRole('button', { name: 'Show the heap' }).click()
    await page.getByRole('dialog').getByLabel('Token').waitFor()
    await page.keyboard.press('Escape')
    await unlock(page, service.token)
    let asked
    await page.route('**/v1/films', async (route) => {
      asked = route.request().postDataJSON()
      items = [made]
      await route.fulfill({ status: 202, json: made.job })
    })
    await section().getByRole('button', { name: 'Show the heap' }).click()
    await section().locator('canvas').waitFor()
    assert.deepEqual(asked, { set: SET })
  })

  it('both have the same width of base and their fits, which can be hidden; the table has the difference', async () => {
    await becomes(angles, [
      ['Apex, this pair', '33.40', '0.41', '35.00', '+1.60'],
      ['Cone, this pair', '32.90', '0.22', '34.50', '+1.60'],
      ['Apex, means', '33.40', '0.41', '33.90', '+0.50'],
    ])
    await becomes(() => section().locator('.apart strong').textContent(), '+1.60°')
    const fit = section().getByRole('img', { name: /^The fit over pile 1/ })
    await becomes(() => fit.getAttribute('aria-label'), /33\.40 degrees from the apex/)
    await holds(async () => {
      const box = await section().locator('.frame').boundingBox()
      const base = await fit.locator('.over path').nth(3).boundingBox()
      assert.ok(Math.abs(base.width / box.width - 1 / 1.5) < 0.02, `${base.width} of ${box.width}`)
    })
    const canvas = section().locator('canvas')
    await becomes(() => section().getByRole('img', { name: /^Side view of a heap/ }).getAttribute('aria-label'), /35\.00 degrees from the apex and 34\.50 by the cone/)
    const drawn = () => canvas.evaluate((element) => element.toDataURL())
    const withFit = await drawn()
    await section().getByLabel('Show the fits').uncheck()
    await becomes(() => fit.count(), 0)
    await page.waitForFunction(([before]) => document.querySelector('canvas').toDataURL() !== before, [withFit])
    await section().getByLabel('Show the fits').check()
    assert.deepEqual(await accessibilityFaults(page), [])
    await section().scrollIntoViewIfNeeded()
    await picture(page, 'heaps')
  })

  it('the heap is poured again, from the keyboard too', async () => {
    const slider = section().getByRole('slider', { name: 'Simulated time' })
    await slider.focus()
    await page.keyboard.press('Home')
    await becomes(() => slider.getAttribute('aria-valuetext'), `0.00 s, ${half} grains`)
    await section().getByRole('button', { name: 'Pour it again' }).click()
    await page.waitForFunction(() => document.querySelector('input[type=range]').getAttribute('aria-valuetext').startsWith('1.00 s'), undefined, { timeout: 15_000 })
  })

  it('fits a phone, in both themes', async () => {
    await page.setViewportSize({ width: 390, height: 800 })
    assert.ok(await fits(page))
    await page.emulateMedia({ colorScheme: 'dark' })
    assert.deepEqual(await accessibilityFaults(page), [])
    await section().scrollIntoViewIfNeeded()
    await picture(page, 'heaps-phone-dark')
    await page.emulateMedia({ colorScheme: 'light' })
    await page.setViewportSize({ width: 1400, height: 900 })
  })

  it('on the page of the measurement a table says where the parts are, and a refused pile why it has none', async () => {
    await chromium.open(page, `reposes/${RUN}`)
    const { rows } = await csvOf(page, 'Where the parts are')
    assert.deepEqual(rows.slice(1, 4), [['Tip of the funnel', '424.0', '120.0'], ['Apex', '424.0', '230.0'], ['Base, left end', '304.0', '310.0']])
    await picture(page, 'pile-fit')
    await page.getByRole('combobox', { name: 'Pile' }).selectOption('2')
    await page.getByText('No angle: no bench found.').waitFor()
    await becomes(() => page.getByRole('img', { name: /^The fit over/ }).count(), 0)
    assert.deepEqual(await accessibilityFaults(page), [])
    assert.deepEqual(chromium.complaints, [])
  })
})
