/** Axes of figures drawn as SVG. */
import { num } from './format'

export interface Scale {
  low: number
  high: number
  /** Pixel of a value. */
  at: (value: number) => number
}

/** A scale over all finite values with a little room, from pixel `from` to pixel `to`. */
export function scaleOver(values: (number | null | undefined)[], from: number, to: number): Scale {
  const known = values.filter((v): v is number => typeof v === 'number' && Number.isFinite(v))
  const [least, most] = known.length > 0 ? [known.reduce((a, b) => Math.min(a, b)), known.reduce((a, b) => Math.max(a, b))] : [0, 1]
  const room = most - least > 1e-9 * Math.max(Math.abs(least), Math.abs(most)) ? 0.04 * (most - least) : 0.5
  const [low, high] = [least - room, most + room]
  return { low, high, at: (value) => from + ((to - from) * (value - low)) / (high - low) }
}

export interface Tick {
  value: number
  text: string
}

/** About `count` round values on a scale, as written. */
export function ticks({ low, high }: Scale, count: number): Tick[] {
  const rough = (high - low) / count
  const power = 10 ** Math.floor(Math.log10(rough))
  const step = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= 0.7 * rough) ?? rough
  const decimals = Math.min(9, Math.max(0, -Math.floor(Math.log10(step) + 1e-9)))
  const first = Math.ceil(low / step)
  return Array.from({ length: Math.max(0, Math.floor(high / step) - first + 1) }, (_, k) => (first + k) * step).map((value) => ({ value, text: num(value, decimals) }))
}

/** As many names as remain readable along an axis `room` pixels long. */
export function nameTicks(names: string[], room: number): Tick[] {
  const each = room / Math.max(1, names.length)
  const every = Math.max(1, Math.ceil(38 / each))
  const letters = Math.max(2, Math.floor((each * every) / 6.6))
  const short = (name: string) => (name.length > letters ? `${name.slice(0, letters - 1)}…` : name)
  return names.map((name, value) => ({ value, text: short(name) })).filter((_, k) => k % every === 0)
}
