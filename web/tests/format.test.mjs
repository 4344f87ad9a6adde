/** How numbers and CSV are written: the rules, apart from any view. */
import assert from 'node:assert/strict'
import { after, before, describe, it } from 'node:test'
import { fileURLToPath } from 'node:url'
import { createServer } from 'vite'

let vite, format, csv
before(async () => {
  vite = await createServer({ root: fileURLToPath(new URL('..', import.meta.url)), server: { middlewareMode: true, ws: false, watch: null }, appType: 'custom', logLevel: 'error' })
  format = await vite.ssrLoadModule('/src/format.ts')
  csv = await vite.ssrLoadModule('/src/csv.ts')
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
