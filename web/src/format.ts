/** Formatting of numbers, times and names. The CSV of a table holds exactly what the table shows. */

/** Shown where there is no value. */
export const NONE = '–'

/** A number with fixed decimals and a true minus sign. */
export function num(value: number | null | undefined, decimals = 2): string {
  if (value === null || value === undefined || !Number.isFinite(value)) return NONE
  const text = value.toFixed(decimals)
  return Number(text) === 0 ? text.replace('-', '') : text.replace('-', '−')
}

/** A number that always shows its sign; zero has none. */
export function signed(value: number | null | undefined, decimals = 2): string {
  const text = num(value, decimals)
  return value !== null && value !== undefined && Number(value.toFixed(decimals)) > 0 ? `+${text}` : text
}

/** Decimals that match a balance's readability in mg: 1 mg shows none, 0.1 mg one. */
export function decimalsFor(readability_mg: number | null | undefined): number {
  if (!readability_mg || !(readability_mg > 0)) return 0
  return Math.max(0, Math.ceil(-Math.log10(readability_mg) - 1e-9))
}

/** Up to `digits` significant digits, for parameters that span 0.00005 to 16.5. */
export function significant(value: number | null | undefined, digits = 4): string {
  if (value === null || value === undefined || !Number.isFinite(value)) return NONE
  if (value === 0) return '0'
  const text = Math.abs(value) < 1e-3 ? value.toExponential(digits - 2) : value.toPrecision(digits)
  return text.replaceAll('-', '−')
}

/** A whole number with thin spaces between groups of three digits. */
export function count(value: number | null | undefined): string {
  if (value === null || value === undefined) return NONE
  return String(Math.round(value)).replace(/\B(?=(\d{3})+$)/g, '\u2009')
}

/** Seconds as `42 s`, `3 min 05 s` or `1 h 02 min`. */
export function duration(seconds: number | null | undefined): string {
  if (seconds === null || seconds === undefined || !Number.isFinite(seconds)) return NONE
  const s = Math.round(seconds)
  if (s < 60) return `${s} s`
  if (s < 3600) return `${Math.floor(s / 60)} min ${String(s % 60).padStart(2, '0')} s`
  return `${Math.floor(s / 3600)} h ${String(Math.floor((s % 3600) / 60)).padStart(2, '0')} min`
}

const LOCAL = new Intl.DateTimeFormat(undefined, { year: 'numeric', month: 'short', day: '2-digit', hour: '2-digit', minute: '2-digit', second: '2-digit', hour12: false })

/** An ISO instant in the reader's own time zone. */
export function localTime(iso: string): string {
  const at = new Date(iso)
  return Number.isNaN(at.getTime()) ? iso : LOCAL.format(at)
}

/** `sodium_bicarbonate` or `over_share` as words. */
export function words(name: string): string {
  const text = name.replaceAll(/[_-]+/g, ' ')
  return text.charAt(0).toUpperCase() + text.slice(1)
}

/** Enough of an ID to recognise it. UUIDv7 IDs begin with the time, so their last digits tell them apart. */
export function shortId(id: string): string {
  return id.length === 36 ? `…${id.slice(-8)}` : id
}

/** Mean, or null for no values. */
export function mean(values: number[]): number | null {
  return values.length === 0 ? null : values.reduce((a, b) => a + b, 0) / values.length
}

/** Sample standard deviation, or null for fewer than two values. */
export function sd(values: number[]): number | null {
  const m = mean(values)
  if (m === null || values.length < 2) return null
  return Math.sqrt(values.reduce((a, b) => a + (b - m) ** 2, 0) / (values.length - 1))
}

/** Mean over the last `window` values up to each point; null until one exists. */
export function trailingMean(values: (number | null)[], window: number): (number | null)[] {
  const kept: number[] = []
  return values.map((value) => {
    if (value !== null) kept.push(value)
    if (kept.length > window) kept.shift()
    return mean(kept)
  })
}
