/** Several of a kind side by side: picked in their lists, drawn, read, limited, kept in the address, and taken away as files. */
import assert from 'node:assert/strict'
import { readFileSync } from 'node:fs'
import { after, before, describe, it } from 'node:test'
import { inflateSync } from 'node:zlib'
import { accessibilityFaults, becomes, csvOf, fits, holds, openBrowser, picture, tableCells } from './browser.mjs'
import { startService } from './service.mjs'

let service, chromium, page
const ids = {}
const WIDTHS = [1440, 1280, 390]

before(async () => {
  service = await startService()
  const job = async (path, body) => (await service.post(path, body)).id
  const calibration = { powder: 'sand', method: 'sequential', sets: 2, tolerance_deg: 5, trials_max: 60, particles: 400 }
  ids.calibrations = [await job('/v1/calibrations', calibration), await job('/v1/calibrations', { ...calibration, seed: 7 })]
  for (const id of ids.calibrations) await service.finished(id)
  ids.calibrations.push(await job('/v1/calibrations', { powder: 'sand', method: 'emulator', sets: 2, particles: 100, verify_repeats: 2, tolerance_deg: 5 }))
  const training = { powders: ['sand'], episodes: 40, surrogate_episodes: 40 }
  ids.trainings = [await job('/v1/trainings', { ...training, seed: 1 }), await job('/v1/trainings', { ...training, seed: 2 }), await job('/v1/trainings', { ...training, seed: 1, order: 'random', episodes: 48, surrogate_episodes: 48 })]
  for (const id of ids.trainings) await service.finished(id)
  ids.policies = (await Promise.all(ids.trainings.map((id) => service.get(`/v1/trainings/${id}`)))).map((t) => t.result.policy)
  const evaluation = { controllers: ['policy', 'fixed'], powders: ['sand'], targets_mg: [10, 12], repeats: 2, max_shakes: 3, particles: 1000 }
  ids.evaluations = [await job('/v1/evaluations', { ...evaluation, policy: ids.policies[0] }), await job('/v1/evaluations', { ...evaluation, policy: ids.policies[1] })]
  ids.weighings = []
  for (const [seed, value] of [[3, 12], [4, 10]]) {
    const dose = { powder: 'sand', target: { value, unit: 'mg' }, tolerance: { lower: 1, upper: 1, unit: 'mg' }, seed }
    ids.weighings.push((await service.post('/v1/weighings', dose, { 'idempotency-key': `compare-${seed}` })).id)
  }
  for (const id of [...ids.evaluations, ids.calibrations[2]]) await service.finished(id)
  for (const id of ids.weighings) while ((await service.get(`/v1/weighings/${id}`)).weighing.state !== 'done') await new Promise((go) => setTimeout(go, 200))
  chromium = await openBrowser(service.url)
  page = await chromium.tab()
}, { timeout: 900_000 })

after(async () => {
  await chromium?.browser.close()
  await service?.stop()
})

async function shown(kind, more = '', width = 1440) {
  await page.setViewportSize({ width, height: 900 })
  await chromium.open(page, `compare/${kind}?ids=${ids[kind].join(',')}${more}`)
  await drawn()
}
const drawn = () => page.waitForFunction(() => document.querySelector('main [aria-busy=false]') && document.querySelector('svg.drawing'))
/** What the page itself has in its address now: Playwright learns a change a little later. */
const address = async () => new URLSearchParams((await page.evaluate(() => location.hash)).split('?')[1])
const kept = async (key) => (await address()).get(key)
const figure = (title) => page.locator('figure', { has: page.getByRole('heading', { name: title, exact: true }) })
/** Heading and rows of the table below a drawing, from its own file: a long table draws only the rows in view, and those are a part of it. */
async function tableOf(title) {
  const table = figure(title).getByRole('table', { name: title })
  if ((await table.count()) === 0) await figure(title).getByText(`Table of ${title}`).click()
  return whole(title, table)
}
const whole = (caption, table) =>
  holds(async () => {
    const { rows } = await csvOf(page, caption)
    const seen = await tableCells(table)
    assert.deepEqual(seen.slice(0, 4), rows.slice(0, 4))
    assert.ok(seen.length <= rows.length)
    return rows
  })
async function fileOf(title, kind) {
  const [file] = await Promise.all([page.waitForEvent('download'), page.getByRole('button', { name: `${kind} of ${title}`, exact: true }).click()])
  return { name: file.suggestedFilename(), bytes: readFileSync(await file.path()) }
}
/** Pixels of a PNG of eight bits per channel, without interlacing. */
function pixels(png) {
  assert.deepEqual([...png.subarray(0, 8)], [137, 80, 78, 71, 13, 10, 26, 10])
  const data = []
  let [at, width, height, bytes] = [8, 0, 0, 0]
  for (let kind = ''; kind !== 'IEND'; ) {
    const length = png.readUInt32BE(at)
    kind = png.toString('latin1', at + 4, at + 8)
    const body = png.subarray(at + 8, at + 8 + length)
    if (kind === 'IHDR') [width, height, bytes] = [body.readUInt32BE(0), body.readUInt32BE(4), { 2: 3, 6: 4 }[body[9]]]
    if (kind === 'IDAT') data.push(body)
    at += 12 + length
  }
  const raw = inflateSync(Buffer.concat(data))
  const stride = width * bytes
  assert.equal(raw.length, height * (stride + 1))
  const out = Buffer.alloc(height * stride)
  for (let y = 0; y < height; y++) {
    for (let x = 0; x < stride; x++) {
      const [left, up, corner] = [x >= bytes ? out[y * stride + x - bytes] : 0, y > 0 ? out[(y - 1) * stride + x] : 0, x >= bytes && y > 0 ? out[(y - 1) * stride + x - bytes] : 0]
      const p = left + up - corner
      const [pa, pb, pc] = [Math.abs(p - left), Math.abs(p - up), Math.abs(p - corner)]
      const guess = [0, left, up, (left + up) >> 1, pa <= pb && pa <= pc ? left : pb <= pc ? up : corner][raw[y * (stride + 1)]]
      out[y * stride + x] = (raw[y * (stride + 1) + 1 + x] + guess) & 255
    }
  }
  const colours = new Set()
  for (let k = 0; k < out.length; k += bytes) colours.add(out.readUIntBE(k, 3))
  return { width, height, colours }
}

describe('picking', () => {
  it('by the keyboard alone leads from a list to the comparison', async () => {
    await page.setViewportSize({ width: 1440, height: 900 })
    await chromium.open(page, 'trainings')
    const boxes = page.getByRole('checkbox', { name: /Compare training/ })
    await boxes.nth(2).waitFor()
    await boxes.nth(0).press('Space')
    await becomes(() => boxes.nth(0).isChecked(), true)
    assert.equal(await page.getByRole('region', { name: 'Compare' }).count(), 0)
    await boxes.nth(1).press('Space')
    await page.getByRole('region', { name: 'Compare' }).getByText('2 trainings picked').waitFor()
    assert.deepEqual(await accessibilityFaults(page), [])
    await picture(page, 'compare-picking')
    await boxes.nth(1).press('Enter')
    await page.getByRole('heading', { name: '2 trainings compared' }).waitFor()
    assert.deepEqual(new Set((await kept('ids')).split(',')), new Set(ids.trainings.slice(1)))
  })

  it('by mouse adds up over lists, is changed from the comparison, and cleared', async () => {
    await drawn()
    await page.getByRole('link', { name: 'Change the selection' }).click()
    await page.getByRole('checkbox', { name: new RegExp(`Compare training .*${ids.trainings[0].slice(-8)}`) }).click()
    await page.getByText('3 trainings picked').waitFor()
    await page.getByRole('link', { name: 'Compare 3 trainings' }).click()
    await page.getByRole('heading', { name: '3 trainings compared' }).waitFor()
    await chromium.open(page, 'jobs')
    await page.getByRole('checkbox', { name: new RegExp(`Compare calibration .*${ids.calibrations[0].slice(-8)}`) }).click()
    await chromium.open(page, 'powders/sand')
    await page.getByRole('checkbox', { name: new RegExp(`Compare calibration .*${ids.calibrations[1].slice(-8)}`) }).click()
    await page.getByRole('link', { name: 'Compare 2 calibrations' }).waitFor()
    await page.getByRole('button', { name: 'Clear the picked calibrations' }).click()
    await page.getByRole('region', { name: 'Compare' }).waitFor({ state: 'detached' })
  })

  it('names what cannot be read, and compares the rest', async () => {
    await chromium.open(page, `compare/trainings?ids=${ids.trainings[0]},01a00000-0000-7000-8000-000000000000,${ids.trainings[1]}`)
    await page.getByRole('alert').getByText('01a00000-0000-7000-8000-000000000000').waitFor()
    await drawn()
    await becomes(async () => (await page.locator('svg.drawing path.line').count()) >= 2, true)
    await page.getByRole('button', { name: 'Remove B' }).click()
    await page.getByRole('heading', { name: '2 trainings compared' }).waitFor()
    await chromium.open(page, 'compare/spoons?ids=1,2')
    await page.getByText('There is nothing to compare under “spoons”').waitFor()
  })
})

describe('curves', () => {
  const TITLE = 'Error at the end of the episode'

  it('say what the service says: drawing, table and file', async () => {
    await shown('trainings', '&smooth=1')
    const rows = await tableOf(TITLE)
    const episodes = await Promise.all(ids.trainings.map(async (id) => (await service.get(`/v1/trainings/${id}/episodes?limit=5000`)).items))
    assert.equal(rows.length, 1 + 48)
    episodes.forEach((of, k) => of.forEach((e) => assert.equal(rows[e.index + 1][k + 1], e.final_error_mg.toFixed(2))))
    assert.equal(rows[48][1], '')
    const file = await csvOf(page, `the drawing ${TITLE}`)
    assert.deepEqual(file.rows, rows)
    // The height of a point is its value: two points of the first curve give the scale, all others follow it.
    const drawnAt = await figure(TITLE).locator('path.line').evaluateAll((paths) => paths.map((p) => [...p.getAttribute('d').matchAll(/[ML]([\d.]+) ([\d.]+)/g)].map((m) => [Number(m[1]), Number(m[2])])))
    for (const points of drawnAt) {
      const k = episodes.findIndex((of) => of.length === points.length && matches(points, of))
      assert.ok(k >= 0, 'a curve that is no training')
    }
    function matches(points, of) {
      const values = of.map((e) => e.final_error_mg)
      const [low, high] = [values.indexOf(Math.min(...values)), values.indexOf(Math.max(...values))]
      const scale = (points[high][1] - points[low][1]) / (values[high] - values[low])
      return points.every(([, y], n) => Math.abs(points[low][1] + scale * (values[n] - values[low]) - y) < 0.25)
    }
  })

  it('are smoothed as asked, on a logarithmic axis, and the address brings it all back', async () => {
    await shown('trainings')
    await page.getByLabel('Smoothing').selectOption('5')
    await page.getByLabel('Logarithmic', { exact: true }).check()
    await page.getByLabel('Quantity').selectOption('return')
    await page.getByLabel('Quantity').selectOption('error')
    const plot = figure(TITLE).getByRole('group', { name: new RegExp(TITLE) })
    const box = await plot.boundingBox()
    await page.mouse.move(box.x + 200, box.y + 100)
    await page.mouse.down()
    await page.mouse.move(box.x + 500, box.y + 120, { steps: 4 })
    await page.mouse.up()
    await figure(TITLE).getByRole('button', { name: /A .*seed 1/ }).click()
    const all = async () => Object.fromEntries(await address())
    await becomes(async () => (({ smooth, log, y, focus }) => [smooth, log, y, focus])(await all()), ['5', '1', 'error', ids.trainings[0]])
    const then = await all()
    const [low, high] = then.zoom.split('~').map(Number)
    assert.ok(low > 1 && high < 48 && low < high, then.zoom)
    const lines = () => figure(TITLE).locator('path.line').evaluateAll((paths) => paths.map((p) => p.getAttribute('d')))
    const before = await lines()
    await page.reload()
    await drawn()
    await becomes(lines, before)
    await page.getByRole('link', { name: 'Powders', exact: true }).click()
    await page.getByRole('heading', { name: 'Powders', level: 1 }).waitFor()
    await page.goBack()
    await drawn()
    await becomes(all, then)
    const rows = await tableOf(TITLE)
    const episodes = (await service.get(`/v1/trainings/${ids.trainings[0]}/episodes?limit=5000`)).items.map((e) => e.final_error_mg)
    const first = Number(rows[1][0])
    const mean = episodes.slice(Math.max(0, first - 5), first).reduce((a, b, _, all) => a + b / all.length, 0)
    assert.equal(rows[1][1], mean.toFixed(2))
    await figure(TITLE).getByRole('button', { name: 'Whole range' }).click()
    await becomes(() => kept('zoom'), null)
  })

  it('are read by the arrow keys, by the pointer, and enlarged without a drag', async () => {
    await shown('trainings', '&smooth=1')
    const plot = figure(TITLE).getByRole('group', { name: new RegExp(TITLE) })
    const first = (await service.get(`/v1/trainings/${ids.trainings[0]}/episodes?limit=5000`)).items
    await plot.focus()
    await plot.press('ArrowRight')
    await plot.press('ArrowRight')
    await figure(TITLE).getByText('Episode 2', { exact: true }).waitFor()
    await becomes(() => figure(TITLE).locator('.legend li').first().textContent(), new RegExp(`${first[1].final_error_mg.toFixed(2)} mg`))
    await becomes(() => plot.locator('output').textContent(), /^Episode 2: A [\d.]+ mg, B [\d.]+ mg, C [\d.]+ mg$/)
    await plot.press('End')
    // Two of the three have ended before the last episode of the third.
    await becomes(() => plot.locator('output').textContent(), /^Episode 48: A –, B –, C [\d.]+ mg$/)
    await plot.press('Home')
    await plot.press('+')
    await holds(async () => {
      const [low, high] = (await kept('zoom')).split('~').map(Number)
      assert.ok(low === 1 && high < 30, await kept('zoom'))
    })
    await plot.press('0')
    await becomes(() => kept('zoom'), null)
    const box = await plot.boundingBox()
    await page.mouse.move(box.x + box.width / 2, box.y + 60)
    await becomes(() => figure(TITLE).locator('.legend .at').textContent(), /^Episode 2\d$/)
  })

  it('of doses begin at the tare, over time and over shakes', async () => {
    await shown('weighings')
    const doses = await Promise.all(ids.weighings.map((id) => service.get(`/v1/weighings/${id}`)))
    let rows = await tableOf('Mass in the vial over time')
    assert.deepEqual(rows[1].slice(1), ['0', '0'])
    assert.equal(Number(rows.at(-1)[0]), Number(Math.max(...doses.map((d) => d.ticks.at(-1).t_s - d.ticks[0].t_s)).toFixed(1)))
    await page.getByRole('combobox', { name: /^Over/ }).selectOption('shakes')
    await page.getByRole('combobox', { name: /^Mass/ }).selectOption('left')
    rows = await tableOf('Mass to the target over shakes')
    for (const [k, dose] of doses.entries()) for (const t of dose.ticks) assert.equal(rows[t.step + 1][k + 1], (t.reading.mass_mg - dose.weighing.target_mg).toFixed(2))
    await becomes(async () => Object.fromEntries([...(await address())].filter(([key]) => key !== 'ids')), { x: 'shakes', y: 'left' })
  })
})

describe('calibrations', () => {
  it('show searches, sets, slices and posteriors as the service has them', async () => {
    await shown('calibrations')
    const trials = await Promise.all(ids.calibrations.map(async (id) => (await service.get(`/v1/calibrations/${id}/trials?limit=5000`)).items))
    const best = await tableOf('Best error so far')
    const searched = trials[0].filter((t) => t.phase === 'search')
    assert.equal(best[searched.length][1], Math.min(...searched.map((t) => t.error_deg).filter((e) => e != null)).toFixed(2))
    const sets = await tableOf('Calibrated sets')
    const results = await Promise.all(ids.calibrations.map((id) => service.get(`/v1/calibrations/${id}`)))
    assert.deepEqual(sets.slice(1).map((row) => [row[0], row.at(-1)]), results.flatMap((c, k) => c.result.sets.map((s) => [`${'ABC'[k]} ${s.id}`, (s.verified_error_deg ?? s.error_deg).toFixed(2)])))
    const slices = await tableOf('Error over each parameter')
    assert.equal(slices.filter((row) => row[0].startsWith('A ')).length, searched.filter((t) => t.error_deg != null).length)
    const density = await tableOf('Posterior against prior')
    const { draws } = await service.get(`/v1/calibrations/${ids.calibrations[2]}/posterior`)
    assert.equal(density.length, 1 + 9 * 16)
    const friction = draws.map((d) => d[4])
    const bin = density.slice(1).filter((row) => row[0] === 'Friction')[0]
    assert.equal(bin.at(-1), ((16 * friction.filter((v) => v < 1.3 / 16).length) / friction.length).toFixed(2))
  })

  it('of two with one target say whether they agree, as the service does', async () => {
    const [a, b] = ids.calibrations
    await chromium.open(page, `compare/calibrations?ids=${a},${b}`)
    await drawn()
    const told = await service.get(`/v1/calibrations/${a}/compare?with=${b}`)
    await page.getByRole('status').getByText(`differ by ${Math.abs(told.difference_deg).toFixed(2)}° with a standard error of ${told.standard_error_deg.toFixed(2)}°: they ${told.agree ? 'agree' : 'do not agree'}`).waitFor()
    await shown('calibrations')
  })

  it('rank the parameters by how much the means differ, beside the prior and the spread', async () => {
    const rows = (await whole('Which parameters differ most', page.getByRole('table', { name: 'Which parameters differ most' }))).slice(1)
    assert.equal(rows.length, 9)
    const shares = rows.map((row) => Number(row[1]))
    assert.deepEqual(shares, shares.toSorted((a, b) => b - a))
    const results = await Promise.all(ids.calibrations.map((id) => service.get(`/v1/calibrations/${id}`)))
    const means = results.map((c) => c.result.sets.reduce((sum, s) => sum + s.parameters.friction, 0) / c.result.sets.length)
    const friction = rows.find((row) => row[0] === 'Friction')
    assert.equal(Number(friction[1]), Math.round((100 * (Math.max(...means) - Math.min(...means))) / 1.3))
    assert.match(friction[3], /^[\d.]+ ± [\d.e-]+$/)
  })

  it('are told apart in the parallel lines as in the legend', async () => {
    const sets = figure('Calibrated sets')
    const strokes = (scope) => scope.evaluateAll((paths) => [...new Set(paths.map((path) => path.getAttribute('stroke')))])
    await holds(async () => assert.deepEqual(await strokes(sets.locator('path.line')), await strokes(sets.locator('.legend svg path'))))
    await picture(page, 'compare-calibrations')
  })

  it('have the names that they were given, and of different powders need not agree', async () => {
    const [a] = ids.calibrations
    const other = await service.post('/v1/calibrations', { powder: 'salt', method: 'sequential', sets: 2, tolerance_deg: 8, trials_max: 60, particles: 400 })
    await service.finished(other.id)
    await service.put(`/v1/labels/calibration/${a}`, { name: 'Dry season' })
    const asked = []
    page.on('request', (request) => request.url().includes('/compare?') && asked.push(request.url()))
    await chromium.open(page, `compare/calibrations?ids=${a},${other.id}`)
    await drawn()
    await page.getByRole('region', { name: 'Selection' }).getByRole('link', { name: 'Dry season' }).waitFor()
    // Whether they agree is not even asked.
    assert.deepEqual(asked, [])
    assert.equal(await page.getByText(/do not agree within/).count(), 0)
    await service.put(`/v1/labels/calibration/${a}`, { name: '' })
    await shown('calibrations')
  })

  it('have pairs that are chosen', async () => {
    await page.getByRole('checkbox', { name: 'Mass', exact: true }).check()
    await becomes(() => kept('pairs'), /particle_mass_ug$/)
    assert.equal((await tableOf('Pairs of parameters')).length, 1 + 6)
  })

  it('are limited on an axis by the keyboard and by a drag, and the table says which sets remain', async () => {
    const sets = figure('Calibrated sets')
    const least = sets.getByRole('slider', { name: '|Error| (°), least' })
    await least.focus()
    for (let k = 0; k < 3; k++) await least.press('PageUp')
    const [low] = (await kept('limit.error')).split('~').map(Number)
    const errors = (await tableOf('Calibrated sets')).slice(1)
    for (const row of errors) assert.equal(row.at(-1), Number(row.at(-2)) >= low - 0.005 ? 'yes' : 'no')
    await becomes(() => sets.locator('path.line.out').count(), errors.filter((row) => row.at(-1) === 'no').length)
    await least.press('Escape')
    await becomes(() => kept('limit.error'), null)
    const axis = await sets.locator('rect.grab').first().boundingBox()
    await page.mouse.move(axis.x + 16, axis.y + 5)
    await page.mouse.down()
    await page.mouse.move(axis.x + 16, axis.y + axis.height / 2, { steps: 4 })
    await page.mouse.up()
    await becomes(() => kept('limit.particle_diameter_mm'), /^0\.2[67]\d*~0\.3\d*$/)
    await sets.getByRole('button', { name: 'Clear the limits' }).click()
    await becomes(() => kept('limit.particle_diameter_mm'), null)
  })

  it('have the axes that are chosen, and lines that are read by the arrow keys', async () => {
    const sets = figure('Calibrated sets')
    await sets.getByText('Axes (10 of 10)').click()
    await sets.getByRole('checkbox', { name: 'Damping' }).uncheck()
    await holds(async () => assert.doesNotMatch(await kept('axes'), /damping/))
    await becomes(() => sets.getByRole('slider', { name: /Damping/ }).count(), 0)
    const region = sets.getByRole('region', { name: /Calibrated sets: \d+ sets over 9 axes/ })
    await region.focus()
    await region.press('ArrowDown')
    await becomes(() => sets.locator('output.reading').textContent(), /^A ps-\w+: Diameter 0\.\d+ mm, .*, \|Error\| \d+\.\d\d °$/)
  })
})

describe('policies and evaluations', () => {
  it('show errors with their spread by powder and target', async () => {
    for (const kind of ['evaluations', 'policies']) {
      await shown(kind)
      const rows = await tableOf('Mean error by powder and target')
      const evaluated = await Promise.all(ids.evaluations.map((id) => service.get(`/v1/evaluations/${id}`)))
      for (const [k, e] of evaluated.entries()) {
        for (const row of e.result.rows.filter((r) => r.controller === 'policy')) {
          const cells = rows.find((cells) => cells[0] === `Sand, ${row.target_mg.toFixed(1)} mg`)
          assert.deepEqual(cells.slice(1 + 3 * k, 4 + 3 * k), [row.mae_mg.toFixed(2), row.sd_mg.toFixed(2), String(row.n)])
        }
      }
    }
    await page.getByText('Without a result: C.').waitFor()
    await shown('evaluations')
    await page.getByLabel('Controller').selectOption('fixed')
    await page.getByLabel('Quantity').selectOption('bias')
    const plot = page.getByRole('group', { name: /Bias by powder and target/ })
    await plot.focus()
    await plot.press('ArrowDown')
    await becomes(() => plot.locator('output').textContent(), /^Sand, 10\.0 mg: A [+−]?\d/)
  })
})

describe('what differs', () => {
  it('is all that the table shows, until the equal rows are asked for', async () => {
    await shown('trainings')
    const names = async () => (await whole('What differs', page.getByRole('table', { name: 'What differs' }))).slice(1)
    const differing = await names()
    for (const row of differing) assert.ok(new Set(row.slice(1, -2)).size > 1, row.join())
    assert.ok(['seed', 'order', 'Policy'].every((name) => differing.some((row) => row[0] === name)))
    await page.getByLabel(/Show the \d+ equal rows too/).check()
    await becomes(() => kept('all'), '1')
    const every = await names()
    assert.ok(every.length > differing.length + 10)
    assert.ok(every.some((row) => row[0] === 'gamma' && new Set(row.slice(1, -2)).size === 1))
  })
})

describe('a drawing as a file', () => {
  it('is an SVG of its own, with title, legend, axes and curves', async () => {
    await shown('trainings')
    const { name, bytes } = await fileOf('Error at the end of the episode', 'SVG')
    assert.equal(name, 'compare-trainings-error.svg')
    const text = bytes.toString('utf8')
    assert.doesNotMatch(text, /var\(|oklab|class=|url\(|NaN|undefined|<style/)
    const told = await page.evaluate((source) => {
      const svg = new DOMParser().parseFromString(source, 'image/svg+xml')
      const lines = [...svg.querySelectorAll('path[stroke-width="2"]')]
      return { wrong: svg.querySelector('parsererror')?.textContent, root: svg.documentElement.namespaceURI, texts: [...svg.querySelectorAll('text')].map((t) => t.textContent), strokes: [...new Set(lines.map((l) => l.getAttribute('stroke')))] }
    }, text)
    assert.equal(told.wrong, undefined)
    assert.equal(told.root, 'http://www.w3.org/2000/svg')
    for (const word of ['Error at the end of the episode', 'A  Curriculum, seed 1', 'B  Curriculum, seed 2', 'C  Random, seed 1', 'Episode', '|Error| (mg)']) assert.ok(told.texts.includes(word), word)
    assert.equal(told.strokes.length, 3)
  })

  it('is a PNG in which every curve has its colour, in the theme in use', async () => {
    const colours = { light: [0x2c45cc, 0xc4690f, 0x0d1020], dark: [0x7f74f2, 0xf2b562, 0xeef6fb] }
    for (const colorScheme of ['light', 'dark']) {
      await page.emulateMedia({ colorScheme })
      const { name, bytes } = await fileOf('Error at the end of the episode', 'PNG')
      assert.equal(name, 'compare-trainings-error.png')
      const { width, height, colours: found } = pixels(bytes)
      assert.ok(width > 1000 && height > 600, `${width} × ${height}`)
      for (const colour of colours[colorScheme]) assert.ok(found.has(colour), `#${colour.toString(16)}`)
    }
    await page.emulateMedia({ colorScheme: 'light' })
  })

  it('is had of every drawing', async () => {
    for (const kind of Object.keys(ids)) {
      await shown(kind)
      for (const figure of await page.locator('figure h2').allTextContents()) {
        const svg = (await fileOf(figure, 'SVG')).bytes.toString('utf8')
        assert.ok(svg.includes(`<title>${figure}</title>`) && (svg.match(/<path/g) ?? []).length > 5, figure)
        assert.ok(pixels((await fileOf(figure, 'PNG')).bytes).colours.size > 3, figure)
      }
    }
  })
})

describe('every comparison', () => {
  for (const width of WIDTHS) {
    it(`fits ${width} px in both themes, and axe finds no fault`, async () => {
      for (const kind of Object.keys(ids)) {
        for (const colorScheme of ['light', 'dark']) {
          await page.emulateMedia({ colorScheme })
          await shown(kind, '', width)
          assert.ok(await fits(page), kind)
          assert.deepEqual(await accessibilityFaults(page), [])
          if (width !== 1280) await picture(page, `compare-${kind}-${colorScheme}-${width}`)
        }
      }
      await page.emulateMedia({ colorScheme: 'light' })
    })
  }

  it('tells twenty apart', async () => {
    await chromium.open(page, `compare/weighings?ids=${Array.from({ length: 25 }, (_, k) => `w-${k}`).join(',')}`)
    await page.getByText('The address names 25; the first 20 are compared.').waitFor()
    const looks = () => page.locator('section[aria-label=Selection] svg path').evaluateAll((paths) => paths.map((p) => `${p.getAttribute('stroke')} ${p.getAttribute('stroke-dasharray')}`).filter((look) => !look.startsWith('null')))
    await becomes(async () => new Set(await looks()).size, 20)
  })

  it('is loaded only when it is asked for, and kept to the strict content security policy and to this host', async () => {
    const tab = await chromium.tab()
    const scripts = []
    tab.on('request', (request) => /\/assets\/.*\.js$/.test(request.url()) && scripts.push(request.url()))
    await chromium.open(tab, 'jobs')
    await tab.getByRole('table', { name: 'Jobs' }).waitFor()
    assert.equal(scripts.filter((url) => url.includes('Compare')).length, 0)
    await chromium.open(tab, `compare/trainings?ids=${ids.trainings.join(',')}`)
    await becomes(() => scripts.filter((url) => url.includes('Compare')).length, 1)
    await tab.close()
    assert.deepEqual(chromium.complaints, [])
  })
})
