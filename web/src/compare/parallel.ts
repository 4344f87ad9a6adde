/** Parallel coordinates: axes, limits set on them, and the colours of the lines. */
import { num, significant } from '../format'
import { ticks, type Tick } from '../scale'
import { rangeOf } from './address'

export type Value = number | string | null

export interface Dimension {
  key: string
  label: string
  unit?: string
  /** One for each line. */
  values: Value[]
  /** Ends of the axis instead of those of the values. */
  ends?: readonly [number, number]
  decimals?: number
}

export interface PlacedAxis extends Dimension {
  low: number
  high: number
  /** Names in the order of the axis, if its values are not numbers. */
  names: string[]
  /** Place of a value between the ends, 0 to 1; null if there is none. */
  share: (value: Value) => number | null
  ticks: Tick[]
}

/** Numbers are placed by size, other values by name. An axis of one value has it in the middle. */
export function placed(dimension: Dimension): PlacedAxis {
  const { values, ends } = dimension
  const names = values.some((v) => typeof v === 'string') ? [...new Set(values.filter((v) => v !== null).map(String))].sort((a, b) => a.localeCompare(b, undefined, { numeric: true })) : []
  const numbers = values.filter((v): v is number => typeof v === 'number' && Number.isFinite(v))
  let [low, high] = names.length > 0 ? [0, names.length - 1] : (ends ?? [Math.min(...numbers), Math.max(...numbers)])
  if (!Number.isFinite(low) || !Number.isFinite(high)) [low, high] = [0, 1]
  if (low === high) [low, high] = [low - 0.5, high + 0.5]
  const number = (value: Value) => (value === null ? null : names.length > 0 ? names.indexOf(String(value)) : typeof value === 'number' && Number.isFinite(value) ? value : null)
  const share = (value: Value) => {
    const v = number(value)
    return v === null || v < 0 && names.length > 0 ? null : (v - low) / (high - low)
  }
  const scale = { low, high, at: (v: number) => v }
  /** An axis of whole numbers has no ticks between them. */
  const whole = numbers.every(Number.isInteger) && !ends
  const written = ticks(scale, 4).filter(({ value }) => !whole || Math.abs(value - Math.round(value)) < 1e-9).map((tick) => (whole ? { ...tick, text: num(tick.value, 0) } : tick))
  return { ...dimension, low, high, names, share, ticks: names.length > 0 ? names.map((text, value) => ({ value, text })) : written }
}

/** A value as its axis and the table write it. */
export const textOf = ({ decimals }: Dimension, value: Value): string => (typeof value === 'number' ? (decimals === undefined ? significant(value) : num(value, decimals)) : (value ?? num(null)))

/** The limits that the address sets on an axis. */
export const limitsOf = (text: string) => rangeOf(text)

/** Whether a line passes every limit; without a value it passes none on that axis. */
export function passes(axes: PlacedAxis[], limits: (readonly [number, number] | undefined)[], line: number): boolean {
  return axes.every((axis, k) => {
    const limit = limits[k]
    if (!limit) return true
    const share = axis.share(axis.values[line] ?? null)
    if (share === null) return false
    const value = axis.low + share * (axis.high - axis.low)
    const slack = 1e-9 * (axis.high - axis.low)
    return value >= limit[0] - slack && value <= limit[1] + slack
  })
}

/** Colour between the least and the greatest of the results. */
export function colourAt(share: number | null): string {
  return share === null ? 'var(--rule-strong)' : `color-mix(in oklab, var(--most) ${(100 * share).toFixed(0)}%, var(--least))`
}
