/** The film of a spoonful or an episode: how its file is read, where its grains are at any moment, and how the page plays it. */
import assert from 'node:assert/strict'
import { after, before, describe, it } from 'node:test'
import { fileURLToPath } from 'node:url'
import { createServer } from 'vite'
import { accessibilityFaults, becomes, csvOf, fits, holds, openBrowser, picture, unlock } from './browser.mjs'
import { startService } from './service.mjs'

const HEAD = {
  simulator: 'pbd-3', grains: 3, frames: 3, falls: 2, grain_mm: 0.3, grain_mg: 0.02, bowl_mm: [5, 3.5, 2], vial_radius_mm: 9, vial_offset_mm: 10, drop_height_mm: 10, every_s: 0.5, duration_s: 1,
  filled_mg: 0.06, vial_mg: 0.02, spilled_mg: 0.02,
  steps: [
    { begins_s: 0, pitch_deg: 90, shake_mm: 4, strokes: 2, fell_mg: 0.02, spoon_mg: 0.02, vial_mg: 0.02 },
    { begins_s: 0.5, pitch_deg: 0, shake_mm: 0, strokes: 0, fell_mg: 0, spoon_mg: 0.02, vial_mg: 0.02 },
  ],
}
/** Grain 0 stays, grain 1 falls into the vial at 0.25 s, grain 2 beside it at 0.3 s. */
const FALLS = [
  { id: 1, reaches: 1, at: 0.25, from: [10, 1, 0], speed: [0, 0, 0] },
  { id: 2, reaches: 0, at: 0.3, from: [-4, 0, -2], speed: [-100, 0, 0] },
]
const FRAMES = [
  { at: 0, pitch: 0, shift: 0, moved: [[0, 100, 0, -50], [1, 400, 100, 0], [2, -400, 0, -200]] },
  { at: 0.5, pitch: 90, shift: 2, moved: [[0, 200, 0, -50]] },
  { at: 1, pitch: 0, shift: 0, moved: [] },
]

/** The file, by its description. */
function file(head = HEAD, layout = 1) {
  const text = new TextEncoder().encode(JSON.stringify(head))
  const bytes = []
  const put = (size, write) => {
    const view = new DataView(new ArrayBuffer(size))
    write(view)
    bytes.push(...new Uint8Array(view.buffer))
  }
  const [u16, i16, u32, f32] = [(v) => put(2, (d) => d.setUint16(0, v, true)), (v) => put(2, (d) => d.setInt16(0, v, true)), (v) => put(4, (d) => d.setUint32(0, v, true)), (v) => put(4, (d) => d.setFloat32(0, v, true))]
  bytes.push(...new TextEncoder().encode('FLIPFILM'))
  u32(layout)
  u32(text.length)
  bytes.push(...text)
  for (let k = 0; k < head.grains; k++) u16(150)
  for (const fall of FALLS) {
    u16(fall.id)
    u16(fall.reaches)
    for (const number of [fall.at, ...fall.from, ...fall.speed]) f32(number)
  }
  for (const frame of FRAMES) {
    for (const number of [frame.at, frame.pitch, frame.shift]) f32(number)
    u32(frame.moved.length)
    for (const [id, ...at] of frame.moved) {
      u16(id)
      at.forEach(i16)
    }
  }
  return Uint8Array.from(bytes)
}

let vite, film, moment, pile, drawing, steps
before(async () => {
  vite = await createServer({ root: fileURLToPath(new URL('..', import.meta.url)), server: { middlewareMode: true, ws: false, watch: null }, appType: 'custom', logLevel: 'error' })
  const load = (name) => vite.ssrLoadModule(`/src/film/${name}.ts`)
  ;[film, moment, pile, drawing, steps] = [await load('file'), await load('moment'), await load('pile'), await load('draw'), await load('steps')]
})
after(() => vite.close())

const near = (found, wanted, off = 1e-5) => assert.ok(found.length === wanted.length && found.every((v, k) => Math.abs(v - wanted[k]) < off), `${found} is not ${wanted}`)
/** x, y, z of the grains at a moment. */
function grainsAt(reel, at) {
  const { grains, count } = reel.at(at)
  return Array.from({ length: count }, (_, k) => [...grains.slice(4 * k, 4 * k + 3)])
}

describe('the file of a film', () => {
  it('is read whole, each grain where it was last recorded', () => {
    const read = film.readFilm(file().buffer)
    assert.deepEqual(read.head, HEAD)
    near([...read.radii], [0.15, 0.15, 0.15])
    near([...read.times], [0, 0.5, 1])
    assert.deepEqual([...read.places.slice(9)], [200, 0, -50, 400, 100, 0, -400, 0, -200, 200, 0, -50, 400, 100, 0, -400, 0, -200])
    assert.deepEqual(read.falls.map((f) => [f.id, f.reaches]), [[1, true], [2, false]])
  })

  it('is refused in words if it is another, newer or cut off', () => {
    const refused = (bytes, text) => assert.throws(() => film.readFilm(bytes.buffer), text)
    refused(new Uint8Array(20), /no film/)
    refused(file(HEAD, 2), /layout 2/)
    assert.throws(() => film.readFilm(file().buffer.slice(0, -4)))
    refused(Uint8Array.from([...file(), 0]), /not whole/)
  })
})

describe('a moment of a film', () => {
  it('turns the spoon and its grains about the middle of the rim, and shifts them along it', () => {
    const reel = new moment.Reel(film.readFilm(file().buffer))
    near(grainsAt(reel, 0)[0], [1, 0, -0.5])
    // Tip down by 90 degrees: 2 mm along the bowl, and 2 mm of shift, are now 4 mm down.
    near(grainsAt(reel, 0.5)[0], [-0.5, 0, -4])
    // Half way between two frames: half the pitch, half the way.
    const [sin, cos] = [Math.SQRT1_2, Math.SQRT1_2]
    const along = 1.5 + 1
    near(grainsAt(reel, 0.25 - 1e-9)[0], [along * cos - 0.5 * sin, 0, -along * sin - 0.5 * cos], 1e-4)
  })

  it('lets a grain fall freely, counts it at the mouth, and leaves it on the floor', () => {
    const reel = new moment.Reel(film.readFilm(file().buffer))
    const at = 0.25 + 0.03
    const grain = grainsAt(reel, at)[1]
    near(grain, [10, 1, -(9810 * 0.03 ** 2) / 2], 1e-4)
    const mouth = 0.25 + Math.sqrt((2 * 10) / 9810)
    assert.deepEqual([reel.at(mouth - 1e-4).vial_mg, reel.at(mouth + 1e-4).vial_mg], [0, 0.02])
    const [, rests] = grainsAt(reel, 1)
    near([rests[2]], [reel.floor + 0.15], 1e-5)
    assert.ok(Math.hypot(rests[0] - 10, rests[1]) < 9)
    // The one that missed has left the picture.
    assert.equal(grainsAt(reel, 1).length, 2)
    assert.equal(grainsAt(reel, 0.31).length, 3)
  })

  it('has no jump where a grain leaves between two frames', () => {
    const reel = new moment.Reel(film.readFilm(file().buffer))
    const [before, after] = [grainsAt(reel, 0.25 - 1e-6)[1], grainsAt(reel, 0.25 + 1e-6)[1]]
    near(before, after, 1e-3)
  })

  it('knows its step', () => {
    const reel = new moment.Reel(film.readFilm(file().buffer))
    assert.deepEqual([0, 0.49, 0.5, 9].map((at) => reel.stepAt(at)), [0, 0, 1, 1])
  })
})

describe('grains that lie in the vial', () => {
  it('stay within its wall, overlap no other in the same place, and form no tower', () => {
    const landings = Array.from({ length: 2000 }, (_, k) => ({ x: 8 + (k % 7), y: (k % 5) - 2 }))
    const spots = pile.heaped(landings, 9, 0.3)
    assert.equal(spots.length, landings.length)
    assert.ok(spots.every((s) => Math.hypot(s.x, s.y) < 9 + 0.3 && s.z > 0.1))
    assert.equal(new Set(spots.map((s) => `${Math.round(s.x / 0.3 - 0.001)} ${s.y.toFixed(3)} ${s.z.toFixed(3)}`)).size, 2000)
    // 2000 grains in a heap whose flanks are one grain for each place: far lower than a tower.
    assert.ok(Math.max(...spots.map((s) => s.z)) < 30 * 0.3)
    assert.deepEqual(pile.heaped(landings, 9, 0.3), spots)
  })
})

describe('the picture', () => {
  it('draws every grain once, as large as it is, within its frame', () => {
    const reel = new moment.Reel(film.readFilm(file().buffer))
    const view = drawing.fit(HEAD, 600)
    const arcs = []
    const ctx = new Proxy({}, { get: (_, name) => (name === 'arc' ? (x, y, r) => arcs.push([x, y, r]) : () => undefined), set: () => true })
    drawing.draw(ctx, reel.at(0), HEAD, view, { ink: '', muted: '', rule: '', glass: '', grains: ['a', 'b', 'c'], edge: '', font: '' })
    assert.equal(arcs.length, 3)
    assert.ok(arcs.every(([x, y, r]) => x > 0 && x < 600 && y > 0 && y < view.height && Math.abs(r - 0.15 * view.scale) < 1e-4))
    // The vial is to the right of the spoon, and below it.
    assert.ok(view.x(HEAD.vial_offset_mm + HEAD.vial_radius_mm) < 600 && view.y(reel.floor) < view.height)
    const low = drawing.fit(HEAD, 600, 200)
    assert.ok(low.height <= 201 && Math.abs((low.x(-HEAD.bowl_mm[0]) + low.x(19)) / 2 - 300) < 40)
  })
})

const tick = (step, mass_mg, spoonful = 1) => ({ step, t_s: step, pitch_deg: 10 * step, action: { incline_change_deg: 1, shake_mm: 4, strokes: 1 }, reading: { mass_mg, stable: true }, spoonful })

describe('the steps of a film', () => {
  it('stand beside what the balance showed after them', () => {
    const ticks = [tick(0, 1), tick(1, 3), tick(2, 3, 2), tick(3, 7, 2)]
    assert.deepEqual(steps.spoonfulsOf(ticks).map((group) => group.map((t) => t.step)), [[0, 1], [2, 3]])
    assert.deepEqual(steps.spoonfulsOf([tick(0, 1)]), [])
    const rows = steps.rowsOf(HEAD, ticks.slice(0, 2))
    assert.deepEqual(rows.map((r) => [r.number, r.fell, r.shownFell, r.shown, r.strokes]), [[1, 0.02, 2, 2, 2], [null, 0, null, null, 0]])
  })
})

describe('on the page of a weighing', () => {
  const ID = '01930000-0000-7000-8000-000000000001'
  const JOB = '01930000-0000-7000-8000-0000000000f1'
  const WEIGHING = {
    id: ID, powder: 'salt', target_mg: 12, tolerance_lower_mg: 1, tolerance_upper_mg: 1, policy: 'p-1', parameter_set: 'ps-1', seed: 1, state: 'done', outcome: 'within', asked: { on_overdose: { action: 'stop' } },
    dispensed_mg: 0.02, reading_mg: 2, error_mg: -10, shakes: 1, seconds: 2, created_at: '2026-01-02T03:04:05Z', finished_at: '2026-01-02T03:05:05Z', bench: 'simulated',
  }
  const job = (state, fraction) => ({ id: JOB, kind: 'film', state, progress: { fraction, message: 'step 1 of 1' }, attempts: 1, cancelling: false, created_at: '2026-01-02T03:06:05Z', started_at: '2026-01-02T03:06:05Z', finished_at: state === 'succeeded' ? '2026-01-02T03:06:09Z' : null, error: null })
  const made = { job: job('succeeded', 1), weighing: ID, spoonful: 1, bench: 'simulated', result: { sha256: 'ab', size_bytes: 300, head: HEAD } }

  let service, chromium, page, items
  before(async () => {
    service = await startService()
    chromium = await openBrowser(service.url)
    page = await chromium.tab()
    await page.route(`**/v1/weighings/${ID}`, (route) => route.fulfill({ json: { weighing: WEIGHING, ticks: [tick(0, 0), tick(1, 2)] } }))
    await page.route(/\/v1\/films\?/, (route) => route.fulfill({ json: { items } }))
    await page.route(`**/v1/films/${JOB}/grains`, (route) => route.fulfill({ body: Buffer.from(file()), contentType: 'application/octet-stream' }))
  }, { timeout: 60_000 })
  after(async () => {
    await chromium?.browser.close()
    await service?.stop()
  })
  const section = () => page.locator('section', { has: page.getByRole('heading', { name: 'The powder' }) })
  const showMade = () => section().getByRole('button', { name: 'Show the grains' }).click()
  const number = (name) => section().locator('.numbers div', { has: page.locator('dt', { hasText: new RegExp(`^${name}`) }) }).locator('dd')

  it('asks for a token before it has one made, and shows how far it is', async () => {
    items = []
    await chromium.open(page, `weighings/${ID}`)
    await section().getByRole('button', { name: 'Show the grains' }).click()
    await page.getByRole('dialog').getByLabel('Token').waitFor()
    await page.keyboard.press('Escape')
    await unlock(page, service.token)
    let asked
    await page.route('**/v1/films', async (route) => {
      asked = route.request().postDataJSON()
      items = [{ ...made, job: job('running', 0.4), result: null }]
      await route.fulfill({ status: 202, json: items[0].job })
    })
    await section().getByRole('button', { name: 'Show the grains' }).click()
    await section().getByRole('progressbar').waitFor()
    assert.deepEqual(asked, { weighing: ID, spoonful: 1 })
    await becomes(() => section().getByRole('progressbar').getAttribute('aria-valuenow'), '40')
    await section().getByRole('button', { name: 'Cancel' }).waitFor()
  })

  it('waits for the list of what was made: asks for none that is there, or that is being made', async () => {
    const begun = { ...made, job: job('running', 0.7), result: null }
    const lists = /\/v1\/films\?/
    let posted = 0
    page.on('request', (request) => (posted += request.method() === 'POST' ? 1 : 0))
    for (const [there, shown] of [[[made], 'slider'], [[begun], 'progressbar']]) {
      let arrive
      const arrival = new Promise((resolve) => (arrive = resolve))
      items = there
      await page.route(lists, (route) => arrival.then(() => route.fulfill({ json: { items } })))
      await chromium.open(page, `weighings/${ID}`)
      await section().getByRole('button', { name: 'Show the grains' }).click()
      await section().getByRole('button', { name: 'One moment…' }).waitFor()
      arrive()
      await section().getByRole(shown).waitFor()
      await page.unroute(lists)
      await page.route(lists, (route) => route.fulfill({ json: { items } }))
    }
    assert.equal(posted, 0)
  })

  it('tries the list again where it was lost', async () => {
    items = [made]
    let lost = true
    let refused = 0
    await page.route(/\/v1\/films\?/, (route) => (lost ? (refused++, route.fulfill({ status: 404, json: {} })) : route.fallback()))
    await chromium.open(page, `weighings/${ID}`)
    await section().getByRole('alert').getByText('The service returned 404').waitFor()
    const before = refused
    await section().getByRole('button', { name: 'Show the grains' }).click()
    await holds(() => assert.ok(refused > before))
    lost = false
    await section().getByRole('button', { name: 'Show the grains' }).click()
    await section().getByRole('slider').waitFor()
  })

  it('plays what was made, stops at the end, and does not begin by itself for who asks for less motion', async () => {
    items = [made]
    await page.emulateMedia({ reducedMotion: 'reduce' })
    await chromium.open(page, `weighings/${ID}`)
    await showMade()
    const play = section().getByRole('button', { name: 'Play' })
    await play.waitFor()
    await becomes(() => number('Simulated time').textContent(), '0.00 s')
    await becomes(() => section().getByRole('img', { name: 'Side view' }).getAttribute('aria-label'), /at 0\.00 s: step 1 of 1, pitch 0\.0 degrees, 0\.00 mg in the vial/)
    await play.click()
    await section().getByRole('button', { name: 'Pause' }).waitFor()
    await play.waitFor({ timeout: 15_000 })
    await becomes(async () => [await number('In the vial').textContent(), await number('Balance before').textContent(), await number('Step$').textContent()], ['0.02 mg', '2 mg', 'back to level'])
    await page.emulateMedia({ reducedMotion: null })
    assert.deepEqual(await accessibilityFaults(page), [])
  })

  it('is scrubbed and stepped from the keyboard, and drawn anew each time', async () => {
    const slider = section().getByRole('slider', { name: 'Simulated time' })
    const image = () => section().locator('canvas').evaluate((canvas) => canvas.toDataURL())
    const end = await image()
    await slider.focus()
    await page.keyboard.press('Home')
    await becomes(() => number('Simulated time').textContent(), '0.00 s')
    await holds(async () => assert.notEqual(await image(), end))
    await page.keyboard.press('ArrowRight')
    await becomes(() => number('Simulated time').textContent(), '0.02 s')
    await section().getByRole('button', { name: 'Step on' }).click()
    await becomes(async () => [await number('Simulated time').textContent(), await number('Pitch').textContent()], ['0.50 s', '90.0°'])
    await becomes(() => slider.getAttribute('aria-valuetext'), /^0\.50 s, step back to level$/)
    await section().getByRole('button', { name: 'Step back' }).click()
    await becomes(() => number('Simulated time').textContent(), '0.00 s')
  })

  it('has a table of its steps that is what the file and the balance say', async () => {
    const { rows } = await csvOf(page, 'Steps of the film')
    assert.deepEqual(rows.slice(1), [['1', '0.00', '90.00', '4.00', '2', '0.02', '+2', '0.02', '0.02'], ['Level', '0.50', '0.00', '', '0', '0.00', '', '0.02', '0.02']])
  })

  it('fits a phone, and is drawn in both themes', async () => {
    await page.setViewportSize({ width: 390, height: 800 })
    assert.ok(await fits(page))
    const image = () => section().locator('canvas').evaluate((canvas) => canvas.toDataURL())
    const light = await image()
    await page.emulateMedia({ colorScheme: 'dark' })
    await page.waitForFunction(([light]) => document.querySelector('canvas').toDataURL() !== light, [light])
    assert.deepEqual(await accessibilityFaults(page), [])
    await picture(page, 'film-phone-dark')
    await page.emulateMedia({ colorScheme: 'light' })
    await page.setViewportSize({ width: 1400, height: 900 })
    assert.deepEqual(chromium.complaints, [])
  })

  it('says what is wrong with a file that is no film', async () => {
    await page.route(`**/v1/films/${JOB}/grains`, (route) => route.fulfill({ body: Buffer.from('nothing'), contentType: 'application/octet-stream' }))
    await chromium.open(page, `weighings/${ID}`)
    await showMade()
    await section().getByText('This is no film.').waitFor()
  })
})

describe('on the page of a training', () => {
  const ID = '01930000-0000-7000-8000-0000000000a1'
  const job = (id, kind) => ({ id, kind, state: 'succeeded', progress: { fraction: 1, message: '' }, attempts: 1, cancelling: false, created_at: '2026-01-02T03:06:05Z', started_at: '2026-01-02T03:06:05Z', finished_at: '2026-01-02T03:06:09Z', error: null })
  const training = (kept_episodes) => ({
    job: job(ID, 'training'), order: 'curriculum', preset: 'flip', episodes: 100, levels: [{ powder: 'salt', repose_deg: 36, sets: ['ps-1'] }], settings: { seed: 1 }, kept_episodes,
    result: { policy: 'p-1', episodes: 100, final_error_mg: 1.2, levels: [] },
  })
  const film = (episode, vial_mg) => ({
    job: job(`01930000-0000-7000-8000-${String(episode).padStart(12, '0')}`, 'film'), training: ID, episode, target_mg: 10, set: 'ps-1', seed: 1,
    result: { sha256: 'ab', size_bytes: 300, head: { ...HEAD, vial_mg, steps: HEAD.steps.map((step) => ({ ...step, vial_mg })) } },
  })

  let service, chromium, page, items, kept
  before(async () => {
    service = await startService()
    chromium = await openBrowser(service.url)
    page = await chromium.tab()
    await page.route(`**/v1/trainings/${ID}`, (route) => route.fulfill({ json: training(kept) }))
    await page.route(`**/v1/trainings/${ID}/episodes?*`, (route) => route.fulfill({ json: { items: [] } }))
    await page.route(/\/v1\/films\?/, (route) => (assert.ok(route.request().url().includes(`training=${ID}`)), route.fulfill({ json: { items } })))
    await page.route('**/v1/films/*/grains', (route) => route.fulfill({ body: Buffer.from(file()), contentType: 'application/octet-stream' }))
  }, { timeout: 60_000 })
  after(async () => {
    await chromium?.browser.close()
    await service?.stop()
  })
  const section = () => page.locator('section', { has: page.getByRole('heading', { name: 'Watch the spoon' }) })
  const choice = (name) => section().getByRole('group', { name: 'Episode' }).getByRole('button', { name, exact: true })

  it('has a button for each kept episode, and has that one made', async () => {
    kept = [1, 10, 100]
    items = []
    await chromium.open(page, `trainings/${ID}`)
    await unlock(page, service.token)
    await becomes(() => section().getByRole('group', { name: 'Episode' }).getByRole('button').allTextContents(), ['Episode 1', 'Episode 10', 'Episode 100'])
    let asked
    await page.route('**/v1/films', async (route) => {
      asked = route.request().postDataJSON()
      items = [film(10, 6.5)]
      await route.fulfill({ status: 202, json: items[0].job })
    })
    await choice('Episode 10').click()
    await section().getByRole('slider', { name: 'Simulated time' }).waitFor()
    assert.deepEqual(asked, { training: ID, episode: 10 })
    await becomes(() => choice('Episode 10').getAttribute('aria-pressed'), 'true')
    await section().getByText('of the target of 10.00 mg fell into the vial, with parameter set ps-1, seed 1').waitFor()
  })

  it('draws the mass of all films over time, with the target, in any width', async () => {
    items = [film(100, 9.8), film(10, 6.5), film(1, 0.2)]
    await chromium.open(page, `trainings/${ID}`)
    await section().getByRole('heading', { name: 'Mass in the vial' }).waitFor()
    await section().getByText('Table of Mass in the vial').click()
    const { rows } = await csvOf(page, 'Mass in the vial')
    assert.deepEqual(rows[0], ['Simulated time (s)', 'Episode 1 (mg)', 'Episode 10 (mg)', 'Episode 100 (mg)'])
    assert.deepEqual(rows.slice(1), [['0.00', '0.00', '0.00', '0.00'], ['0.50', '0.20', '6.50', '9.80'], ['1.00', '0.20', '6.50', '9.80']])
    await choice('Episode 1').click()
    await section().getByRole('slider', { name: 'Simulated time' }).waitFor()
    assert.deepEqual(await accessibilityFaults(page), [])
    await section().scrollIntoViewIfNeeded()
    await picture(page, 'training-films')
    await page.setViewportSize({ width: 390, height: 800 })
    assert.ok(await fits(page))
    await picture(page, 'training-films-phone')
    await page.setViewportSize({ width: 1400, height: 900 })
  })

  it('says that an older training has kept only its policy', async () => {
    kept = [100]
    items = []
    await chromium.open(page, `trainings/${ID}`)
    await section().getByText('ended before FLIP kept the networks').waitFor()
    await becomes(() => section().getByRole('group', { name: 'Episode' }).getByRole('button').count(), 1)
    assert.deepEqual(chromium.complaints, [])
  })
})
