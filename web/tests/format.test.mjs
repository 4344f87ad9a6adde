/** How numbers and CSV are written: the rules, apart from any view. */
import assert from 'node:assert/strict'
import { after, before, describe, it } from 'node:test'
import { fileURLToPath } from 'node:url'
import { createServer } from 'vite'

let vite, format, csv, scale, discovery
before(async () => {
  vite = await createServer({ root: fileURLToPath(new URL('..', import.meta.url)), server: { middlewareMode: true, ws: false, watch: null }, appType: 'custom', logLevel: 'error' })
  format = await vite.ssrLoadModule('/src/format.ts')
  csv = await vite.ssrLoadModule('/src/csv.ts')
  scale = await vite.ssrLoadModule('/src/scale.ts')
  discovery = await vite.ssrLoadModule('/src/discovery.ts')
})
after(() => vite.close())

describe('numbers', () => {
  it('keep their decimals, a true minus, and no negative zero', () => {
    assert.deepEqual([15, -1.456, -0.001, 0].map((v) => format.num(v, 2)), ['15.00', '−1.46', '0.00', '0.00'])
    assert.deepEqual([null, undefined, NaN, Infinity].map((v) => format.num(v)), ['–', '–', '–', '–'])
  })

  it('show their sign where they are differences, and none for what rounds to zero', () => {
    assert.deepEqual([0.42, -0.42, 0.001, 0].map((v) => format.signed(v, 2)), ['+0.42', '−0.42', '0.00', '0.00'])
  })

  it('have the decimals of the balance that read them', () => {
    assert.deepEqual([1, 0.1, 0.01, 0.5, 10].map(format.decimalsFor), [0, 1, 2, 1, 0])
  })

  it('of parameters keep four digits from 0.00005 to 16.5', () => {
    assert.deepEqual([16.5, 0.27, 0, 0.0000359].map((v) => format.significant(v)), ['16.50', '0.2700', '0', '3.59e−5'])
  })

  it('of seconds are told in minutes and hours', () => {
    assert.deepEqual([31.2, 65, 3720, null].map(format.duration), ['31 s', '1 min 05 s', '1 h 02 min', '–'])
  })

  it('in a trailing mean forget what is older than the window', () => {
    assert.deepEqual(format.trailingMean([1, 2, 3, 10], 2), [1, 1.5, 2.5, 6.5])
    assert.deepEqual(format.trailingMean([null, 4], 2), [null, 4])
  })
})

describe('axes', () => {
  it('have round ticks within their ends', () => {
    const written = (...values) => scale.ticks(scale.scaleOver(values, 0, 100), 5).map((tick) => tick.text)
    assert.deepEqual(written(0, 1), ['0.0', '0.2', '0.4', '0.6', '0.8', '1.0'])
    assert.deepEqual(written(-3, 2), ['−3', '−2', '−1', '0', '1', '2'])
    assert.deepEqual(written(30, null, 70, NaN), ['30', '40', '50', '60', '70'])
  })

  it('stay finite for one value and for none', () => {
    for (const values of [[5, 5], [], [null]]) {
      const { low, high, at } = scale.scaleOver(values, 0, 100)
      assert.ok(low < high && Number.isFinite(at(low)), String(values))
    }
  })

  it('write as many names as have room', () => {
    assert.deepEqual(scale.nameTicks(['Aiko', 'Bartholomew the Second'], 200).map((tick) => tick.text), ['Aiko', 'Bartholomew th…'])
    assert.deepEqual(scale.nameTicks(Array.from({ length: 20 }, (_, k) => String(k)), 200).map((tick) => tick.value), [0, 4, 8, 12, 16])
  })
})

describe('the words of an investigation', () => {
  it('name columns with their units, and causes as a chemist would', () => {
    assert.deepEqual(['relative_humidity_pct', 'vibration_rms_m_s2', 'operator', 'rest_min'].map(discovery.columnName), ['Relative humidity (%)', 'Vibration (rms) (m/s²)', 'Operator', 'Time at rest (min)'])
    assert.deepEqual(['humidity', 'humid_ageing', 'unknown: pressure_hpa'].map(discovery.causeName), ['Humidity', 'Ageing at rest in humid air', 'Unknown cause, with pressure'])
  })

  it('do not round a chance to nothing or to certainty', () => {
    assert.deepEqual([0, 0.001, 0.934, 0.999, 1].map(discovery.percent), ['0', '< 1', '93', '> 99', '100'])
    assert.deepEqual([0.5, 0.02, 0.0021, 0.0002].map(discovery.chance), ['0.50', '0.020', '0.002', '0.0002'])
  })
})

describe('CSV', () => {
  const columns = [
    { key: 'a', label: 'Powder', text: (r) => r.name },
    { key: 'b', label: 'Error', unit: 'mg', text: (r) => format.signed(r.error, 2) },
    { key: 'c', label: 'At', text: () => 'never shown', iso: (r) => r.at },
  ]

  it('quotes what would break it and writes numbers a spreadsheet reads', () => {
    const rows = [
      { name: 'Salt, fine', error: -1.5, at: '2026-01-02T03:04:05Z' },
      { name: 'The "best"\nsugar', error: null, at: '' },
    ]
    assert.equal(csv.toCsv(columns, rows), 'Powder,Error (mg),At\r\n"Salt, fine",-1.50,2026-01-02T03:04:05Z\r\n"The ""best""\nsugar",,\r\n')
  })
})
