/** What the drawings of a comparison rest on: looks, axes, curves, limits, the address. Apart from any view. */
import assert from 'node:assert/strict'
import { readFileSync } from 'node:fs'
import { after, before, describe, it } from 'node:test'
import { fileURLToPath } from 'node:url'
import { createServer } from 'vite'

const root = fileURLToPath(new URL('..', import.meta.url))
let vite, marks, axis, curve, address, differs, parallel, posterior, settings
before(async () => {
  vite = await createServer({ root, server: { middlewareMode: true, ws: false, watch: null }, appType: 'custom', logLevel: 'error' })
  const load = (name) => vite.ssrLoadModule(`/src/compare/${name}.ts`)
  ;[marks, axis, curve, address, differs, parallel, posterior, settings] = await Promise.all(['marks', 'axis', 'curve', 'address', 'differs', 'parallel', 'posterior', 'settings'].map(load))
})
after(() => vite.close())

/** sRGB without its gamma. */
const linear = (hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16) / 255).map((c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4))
const times = (m, v) => [0, 3, 6].map((i) => m[i] * v[0] + m[i + 1] * v[1] + m[i + 2] * v[2])
/** Machado, Oliveira and Fernandes 2009, severity 1. */
const VISION = {
  normal: [1, 0, 0, 0, 1, 0, 0, 0, 1],
  protanopia: [0.152286, 1.052583, -0.204868, 0.114503, 0.786281, 0.099216, -0.003882, -0.048116, 1.051998],
  deuteranopia: [0.367322, 0.860646, -0.227968, 0.280085, 0.672501, 0.047413, -0.01182, 0.04294, 0.968881],
  tritanopia: [1.255528, -0.076749, -0.178779, -0.078411, 0.930809, 0.147602, 0.004733, 0.691367, 0.3039],
}
/** Oklab, Ottosson 2020. */
function lab(rgb) {
  const cone = times([0.4122214708, 0.5363325363, 0.0514459929, 0.2119034982, 0.6806995451, 0.1073969566, 0.0883024619, 0.2817188376, 0.6299787005], rgb.map((c) => Math.min(1, Math.max(0, c)))).map(Math.cbrt)
  return times([0.2104542553, 0.793617785, -0.0040720468, 1.9779984951, -2.428592205, 0.4505937099, 0.0259040371, 0.7827717662, -0.808675766], cone)
}
const light = (hex) => linear(hex).reduce((sum, c, k) => sum + c * [0.2126, 0.7152, 0.0722][k], 0)
const contrast = (a, b) => (Math.max(light(a), light(b)) + 0.05) / (Math.min(light(a), light(b)) + 0.05)

describe('the looks of lines', () => {
  const colours = (file, name) => [...readFileSync(`${root}src/${file}`, 'utf8').matchAll(new RegExp(`--${name}: light-dark\\((#\\w+), (#\\w+)\\)`, 'g'))].map((m) => [m[1], m[2]])

  it('are apart for every kind of colour vision, and stand out from the sheet, in both themes', () => {
    const pairs = colours('compare/lines.css', 'line-\\d')
    const [sheet] = colours('tokens.css', 'sheet')
    assert.equal(pairs.length, marks.COLOURS)
    for (const theme of [0, 1]) {
      const used = pairs.map((pair) => pair[theme])
      for (const colour of used) assert.ok(contrast(colour, sheet[theme]) >= 3, `${colour} on ${sheet[theme]}`)
      for (const [name, matrix] of Object.entries(VISION)) {
        const seen = used.map((hex) => lab(times(matrix, linear(hex))))
        seen.forEach((a, i) => seen.slice(0, i).forEach((b, j) => assert.ok(Math.hypot(...a.map((v, k) => v - b[k])) > 0.14, `${used[i]} and ${used[j]} for ${name}`)))
      }
    }
  })

  it('differ for all twenty, and so do their points', () => {
    const twenty = Array.from({ length: 20 }, (_, k) => k)
    assert.equal(new Set(twenty.map((k) => `${marks.colourOf(k)} ${marks.dashOf(k)}`)).size, 20)
    assert.equal(new Set(twenty.map((k) => `${marks.colourOf(k)} ${marks.pointOf(k, 0, 0, 3)}`)).size, 20)
    assert.deepEqual([0, 19].map(marks.letterOf), ['A', 'T'])
  })

  it('have labels that do not cover each other, and stay where they have room', () => {
    const at = marks.spread([[0, 50], [5, 51], [3, 98], [200, 50]], 14, 12, 0, 100)
    assert.deepEqual(at, [44.5, 56.5, 98, 50])
    const low = marks.spread([[0, 99], [0, 99], [0, 99]], 14, 12, 0, 100)
    assert.deepEqual([...low].sort((a, b) => a - b), [76, 88, 100])
  })
})

describe('axes that zoom', () => {
  it('find the value under a pixel', () => {
    for (const log of [false, true]) {
      const { at, back } = axis.axisOver([2, 300], { from: 40, to: 640, count: 5, log })
      for (const v of [2, 17, 300]) assert.ok(Math.abs(back(at(v)) - v) < 1e-9 * v, `${v} ${log}`)
    }
  })
  it('have powers of ten on a logarithmic scale, and leave out what it cannot show', () => {
    const { ticks, low } = axis.axisOver([0, -3, null, 0.01, 1000], { from: 0, to: 400, count: 5, log: true })
    assert.deepEqual(ticks.map((t) => t.text), ['0.01', '0.1', '1', '10', '100', '1000'])
    assert.ok(low > 0)
    assert.deepEqual(axis.axisOver([1, 10], { from: 0, to: 400, count: 5, log: true }).ticks.map((t) => t.text), ['1', '2', '5', '10'])
  })
  it('keep the ends they are given, start at zero where they should, and are finite without values', () => {
    const given = axis.axisOver([5, 6], { from: 0, to: 100, count: 4, ends: [0, 10] })
    assert.deepEqual([given.low, given.high], [0, 10])
    assert.equal(axis.axisOver([5, 6], { from: 0, to: 100, count: 4, zero: true }).low, 0)
    assert.ok(axis.axisOver([-5, 6], { from: 0, to: 100, count: 4, zero: true }).low < -5)
    for (const log of [false, true]) for (const values of [[], [null], [7], [7, 7]]) assert.ok(Number.isFinite(axis.axisOver(values, { from: 0, to: 9, count: 3, log }).at(7)))
  })
})

describe('curves', () => {
  it('of the best so far never rise, and wait for the first value', () => {
    assert.deepEqual(curve.bestSoFar([null, 3, undefined, 4, 1, NaN, 2]), [null, 3, 3, 3, 1, 1, 1])
  })
  it('are thinned without losing a peak', () => {
    const y = Array.from({ length: 10_000 }, (_, k) => Math.sin(k) + (k === 4321 ? 50 : 0))
    const whole = { x: y.map((_, k) => k), y }
    const thin = curve.thinned(whole, (x) => x / 20)
    assert.ok(thin.x.length <= 4 * 502, String(thin.x.length))
    assert.equal(Math.max(...thin.y), Math.max(...y))
    assert.equal(Math.min(...thin.y), Math.min(...y))
    assert.deepEqual([...thin.x].sort((a, b) => a - b), thin.x)
  })
  it('are cut where they cross the ends of the view', () => {
    const line = { x: [0, 10, 20], y: [0, 100, 0] }
    assert.deepEqual(curve.within(line, 5, 15, false), { x: [5, 10, 15], y: [50, 100, 50] })
    assert.deepEqual(curve.within(line, 5, 15, true), { x: [5, 10, 15], y: [0, 100, 100] })
    assert.deepEqual(curve.within(line, 0, 20, false), line)
    assert.deepEqual(curve.within(line, 10, 20, false), { x: [10, 20], y: [100, 0] })
    assert.deepEqual(curve.within(line, 30, 40, false), { x: [], y: [] })
  })
  it('are read at the nearest point, steps at the last one reached', () => {
    const line = { x: [0, 10, 20], y: [0, 1, 2] }
    assert.deepEqual([-1, 4, 6, 20, 21].map((v) => curve.reads(line, v, false)), [-1, 0, 1, 2, -1])
    assert.deepEqual([-1, 4, 10, 19, 99].map((v) => curve.reads(line, v, true)), [-1, 0, 1, 1, 2])
    assert.equal(curve.reads({ x: [], y: [] }, 1, false), -1)
  })
  it('break where there is no value', () => {
    const path = curve.pathOf({ x: [0, 1, 2, 3], y: [1, null, 2, 3] }, (x) => x, (y) => y, false)
    assert.equal(path, 'M0.0 1.0M2.0 2.0L3.0 3.0')
    assert.equal(curve.pathOf({ x: [0, 1], y: [1, 2] }, (x) => x, (y) => y, true), 'M0.0 1.0H1.0V2.0')
    assert.equal(curve.pathOf({ x: [0, 1], y: [0, 1] }, (x) => x, Math.log, false), 'M1.0 0.0')
  })
})

describe('the address', () => {
  it('keeps ranges, and forgives what is not one', () => {
    assert.deepEqual(address.rangeOf('80~12'), [12, 80])
    for (const text of ['', '5', '5~', 'a~b', '3~3', '1~2~3', '~4']) assert.equal(address.rangeOf(text), undefined, text)
    assert.deepEqual(address.rangeOf(address.rangeText(0.00001234567, 1200)), [0.000012346, 1200])
  })
  it('names each thing once', () => {
    assert.deepEqual(address.listOf(' a,b,,a '), ['a', 'b'])
  })
})

describe('what differs', () => {
  it('is told from what is equal, results first, and names what some lack', () => {
    const rows = differs.rowsOf([
      [{ part: 'Setting', name: 'seed', text: '1' }, { part: 'Result', name: 'Error', text: '2' }, { part: 'Setting', name: 'lr', text: '0.1' }],
      [{ part: 'Setting', name: 'seed', text: '1' }, { part: 'Result', name: 'Error', text: '3' }],
    ], '–')
    assert.deepEqual(rows.map((r) => [r.name, r.cells, r.equal]), [['Error', ['2', '3'], false], ['seed', ['1', '1'], true], ['lr', ['0.1', '–'], false]])
  })
  it('becomes axes: numbers as numbers, names as names, each once', () => {
    const found = settings.settingAxes([
      { seed: 1, order: 'random', same: 5, settings: { seed: 1, tau: 0.1 } },
      { seed: 2, order: 'curriculum', same: 5, settings: { tau: 0.2 } },
    ])
    assert.deepEqual(found.map((d) => [d.label, d.values]), [['Seed', [1, 2]], ['Order', ['random', 'curriculum']], ['Tau', [0.1, 0.2]]])
  })
})

describe('parallel coordinates', () => {
  it('place numbers by size and names in order', () => {
    const number = parallel.placed({ key: 'a', label: 'A', values: [0, 5, null, 10] })
    assert.deepEqual(number.values.map(number.share), [0, 0.5, null, 1])
    const name = parallel.placed({ key: 'b', label: 'B', values: ['y', 'x', 'z'] })
    assert.deepEqual(name.names, ['x', 'y', 'z'])
    assert.deepEqual(name.values.map(name.share), [0.5, 0, 1])
    const one = parallel.placed({ key: 'c', label: 'C', values: [3, 3] })
    assert.deepEqual(one.values.map(one.share), [0.5, 0.5])
    assert.deepEqual(parallel.placed({ key: 'd', label: 'D', values: [1, 3] }).ticks.map((t) => t.text), ['1', '2', '3'])
  })
  it('pass every limit or none', () => {
    const axes = [parallel.placed({ key: 'a', label: 'A', values: [0, 5, null, 10] }), parallel.placed({ key: 'b', label: 'B', values: ['x', 'y', 'x', 'y'] })]
    const passing = (...limits) => [0, 1, 2, 3].filter((k) => parallel.passes(axes, limits, k))
    assert.deepEqual(passing(undefined, undefined), [0, 1, 2, 3])
    assert.deepEqual(passing([0, 5], undefined), [0, 1])
    assert.deepEqual(passing([0, 5], [0.6, 1.4]), [1])
  })
})

describe('posteriors', () => {
  it('are one where they equal the prior, and their mean is one', () => {
    const level = Array.from({ length: 1600 }, (_, k) => (k + 0.5) / 1600)
    assert.deepEqual(new Set(posterior.density(level, 0, 1)), new Set([1]))
    const some = posterior.density([0, 0.1, 0.11, 1], 0, 1)
    assert.equal(some.reduce((a, b) => a + b) / posterior.BINS, 1)
    assert.deepEqual([some[0], some[1], some.at(-1)], [4, 8, 4])
  })
  it('have the correlation of Pearson', () => {
    assert.ok(Math.abs(posterior.correlation([1, 2, 3], [2, 4, 6]) - 1) < 1e-12)
    assert.ok(Math.abs(posterior.correlation([1, 2, 3, 4], [1, -1, -1, 1])) < 1e-12)
    assert.ok(Math.abs(posterior.correlation([0, 1, 2], [0, 1, 0.5]) - 0.5) < 1e-12)
    assert.equal(posterior.correlation([1, 1], [2, 3]), null)
  })
})
