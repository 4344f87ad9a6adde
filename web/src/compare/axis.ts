/** Axes of drawings that can be zoomed and made logarithmic. */
import { num } from '../format'
import { scaleOver, ticks, type Scale, type Tick } from '../scale'

export interface Axis extends Scale {
  log: boolean
  /** Value at a pixel. */
  back: (pixel: number) => number
  ticks: Tick[]
}

export interface Over {
  /** Pixels of its ends. */
  from: number
  to: number
  /** About how many numbers it shows. */
  count: number
  log?: boolean
  /** Starts at zero, if no value is negative; not on a logarithmic axis. */
  zero?: boolean
  /** These ends instead of those of the values. */
  ends?: readonly [number, number]
}

/** An axis over all finite values; a logarithmic one over those above zero. */
export function axisOver(values: Iterable<number | null | undefined>, { from, to, count, log = false, zero = false, ends }: Over): Axis {
  let [low, high] = [Infinity, -Infinity]
  for (const v of values) {
    if (typeof v !== 'number' || !Number.isFinite(v) || (log && v <= 0)) continue
    if (v < low) low = v
    if (v > high) high = v
  }
  if (ends) [low, high] = ends
  return log ? logarithmic(low, high, from, to, count, !ends) : linear(low, high, from, to, count, zero && low >= 0, !ends)
}

function linear(least: number, most: number, from: number, to: number, count: number, zero: boolean, room: boolean): Axis {
  const scale = scaleOver([zero ? 0 : least, most], from, to)
  const low = zero ? 0 : room || most <= least ? scale.low : least
  const high = room || most <= least ? scale.high : most
  const at = (value: number) => from + ((to - from) * (value - low)) / (high - low)
  const back = (pixel: number) => low + ((high - low) * (pixel - from)) / (to - from)
  return { low, high, at, back, log: false, ticks: ticks({ low, high, at }, count) }
}

function logarithmic(least: number, most: number, from: number, to: number, count: number, room: boolean): Axis {
  if (!(most > 0)) [least, most] = [1, 10]
  const grow = room ? 1.08 : 1
  const [low, high] = most > least * 1.02 ? [least / grow, most * grow] : [least / 2, most * 2]
  const [a, b] = [Math.log(low), Math.log(high)]
  const at = (value: number) => from + ((to - from) * (Math.log(value) - a)) / (b - a)
  const back = (pixel: number) => Math.exp(a + ((b - a) * (pixel - from)) / (to - from))
  return { low, high, at, back, log: true, ticks: powers(low, high, count) ?? ticks({ low, high, at }, count) }
}

/** 1, 2 and 5 times powers of ten, or powers of ten alone where those would be too many; none where there are too few. */
function powers(low: number, high: number, count: number): Tick[] | undefined {
  const first = Math.floor(Math.log10(low))
  const decades = Array.from({ length: Math.ceil(Math.log10(high)) - first + 1 }, (_, k) => first + k)
  const within = (steps: number[]) => decades.flatMap((d) => steps.map((s) => ({ value: s * 10 ** d, text: num(s * 10 ** d, Math.max(0, -d)) }))).filter(({ value }) => value >= low && value <= high)
  const dense = within([1, 2, 5])
  if (dense.length < 3) return undefined
  if (dense.length <= 1.6 * count) return dense
  const sparse = within([1])
  const every = Math.ceil(sparse.length / (1.6 * count))
  return sparse.filter((_, k) => k % every === 0)
}
