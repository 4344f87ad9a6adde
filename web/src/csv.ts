/** CSV as in RFC 4180, from exactly the cells a table shows. */
import { NONE } from './format'

/** A column of a table: its heading, and the text of its cell. */
export interface Column<Row> {
  /** Unique within the table; names the sort order in the address. */
  key: string
  label: string
  /** Goes into the heading, so that cells stay numbers. */
  unit?: string
  /** Text shown and exported. */
  text: (row: Row) => string
  /** Value to sort by; without it the column cannot be sorted. */
  sort?: (row: Row) => number | string | null | undefined
  /** An ISO time behind a local one: shown on hover, exported instead of the text. */
  iso?: (row: Row) => string | null | undefined
  /** Text columns are left-aligned; numbers (the default) right-aligned. */
  left?: boolean
  /** Link target of the cell. */
  href?: (row: Row) => string | null | undefined
  mono?: boolean
  /** Long text that may wrap. */
  wrap?: boolean
  /** Read out as the heading of the row. */
  rowHeader?: boolean
  /** The word of the glossary that explains the heading. */
  word?: string
  /** What the heading means in this table, in one sentence, where the glossary has no word for it. */
  means?: string
}

/** Heading with its unit, as shown and exported. */
export function heading<Row>(column: Column<Row>): string {
  return column.unit ? `${column.label} (${column.unit})` : column.label
}

/** A cell's text as exported: ASCII minus, no group spaces, empty for none. */
const plain = (text: string) => (text === NONE ? '' : text.replaceAll('−', '-').replaceAll('\u2009', ''))

/** The cell as exported: an ISO time where there is one. */
export function exported<Row>(column: Column<Row>, row: Row): string {
  return plain(column.iso?.(row) ?? column.text(row))
}

/** Rows with CRLF line endings. */
function lines(rows: string[][]): string {
  const quote = (text: string) => (/[",\r\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text)
  return rows.map((cells) => cells.map(quote).join(',') + '\r\n').join('')
}

/** The whole document, with CRLF line endings. */
export function toCsv<Row>(columns: Column<Row>[], rows: Row[]): string {
  return lines([columns.map(heading), ...rows.map((row) => columns.map((column) => exported(column, row)))])
}

/** The same of a table that the service rendered. */
export const tableCsv = (table: HTMLTableElement): string => lines([...table.rows].map((row) => [...row.cells].map((cell) => plain(cell.textContent.trim()))))

/** Downloads `content` as a file. */
export function download(name: string, content: string | Blob, type = 'text/csv;charset=utf-8'): void {
  const url = URL.createObjectURL(new Blob([content], { type }))
  const link = document.createElement('a')
  link.href = url
  link.download = name
  link.click()
  setTimeout(() => URL.revokeObjectURL(url), 10_000)
}
