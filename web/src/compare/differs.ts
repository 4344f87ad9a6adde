/** What differs between things, as the rows of a table. */

/** One thing that is known about an item: where it belongs, its name with its unit, and its value as text. */
export interface Fact {
  part: 'Result' | 'Input' | 'Setting'
  name: string
  text: string
}

export interface Row {
  part: Fact['part']
  name: string
  /** One for each item. */
  cells: string[]
  equal: boolean
  /** The greatest less the least value, as a share of the greatest magnitude; null unless all of them are numbers. */
  by: number | null
}

function difference(cells: string[]): number | null {
  const values = cells.map((cell) => (/^[−+-]?[\d\u2009.]+(e[−-]?\d+)?$/.test(cell) ? Number(cell.replaceAll('−', '-').replaceAll('\u2009', '')) : NaN))
  if (values.length < 2 || !values.every(Number.isFinite)) return null
  const most = Math.max(...values.map(Math.abs))
  return most > 0 ? (Math.max(...values) - Math.min(...values)) / most : 0
}

/** One row for every fact that any item has, in the order in which they come; `none` where an item does not have it. */
export function rowsOf(items: Fact[][], none: string): Row[] {
  const rows = new Map<string, Row>()
  items.forEach((facts, k) => {
    for (const { part, name, text } of facts) {
      const key = `${part} ${name}`
      const row = rows.get(key) ?? { part, name, cells: items.map(() => none), equal: false, by: null }
      row.cells[k] = text
      rows.set(key, row)
    }
  })
  const order: Fact['part'][] = ['Result', 'Input', 'Setting']
  const sorted = [...rows.values()].sort((a, b) => order.indexOf(a.part) - order.indexOf(b.part))
  return sorted.map((row) => ({ ...row, equal: row.cells.every((cell) => cell === row.cells[0]), by: difference(row.cells) }))
}
