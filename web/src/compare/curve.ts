/** Curves as they are drawn: smoothed, cut to the part in view, and thinned to what pixels can show. */
import { trailingMean } from '../format'

export interface Curve {
  x: number[]
  /** Null where there is no value. */
  y: (number | null)[]
}

/** Least value up to each point; null until one exists. */
export function bestSoFar(values: (number | null | undefined)[]): (number | null)[] {
  let best: number | null = null
  return values.map((v) => (typeof v === 'number' && Number.isFinite(v) ? (best = best === null ? v : Math.min(best, v)) : best))
}

/** Mean over the last `window` values up to each point; the values themselves for a window of one. */
export const smoothed = (curve: Curve, window: number): Curve => (window > 1 ? { x: curve.x, y: trailingMean(curve.y, window) } : curve)

/** Number of x values at or below `value`; x ascends. */
export function upTo(x: number[], value: number): number {
  let [low, high] = [0, x.length]
  while (low < high) {
    const middle = (low + high) >> 1
    if ((x[middle] as number) <= value) low = middle + 1
    else high = middle
  }
  return low
}

/** Index of the point that a cursor at `value` reads: the nearest, or for steps the last one reached. -1 before the first, and after the last of a line; steps keep their last height. */
export function reads({ x }: Curve, value: number, steps: boolean): number {
  const after = upTo(x, value)
  if (after === 0 || steps) return after - 1
  if (after === x.length) return x[after - 1] === value ? after - 1 : -1
  return value - (x[after - 1] as number) <= (x[after] as number) - value ? after - 1 : after
}

/** The part of a curve between two values of x, with its crossings of the ends; steps keep their height. */
export function within(curve: Curve, low: number, high: number, steps: boolean): Curve {
  const { x, y } = curve
  const first = upTo(x, low)
  const last = upTo(x, high)
  const cut: Curve = { x: x.slice(first, last), y: y.slice(first, last) }
  const cross = (k: number, at: number): number | null => {
    const [y0, y1, x0, x1] = [y[k - 1], y[k], x[k - 1], x[k]]
    if (y0 === null || y0 === undefined || x0 === undefined) return null
    if (steps) return y0
    if (y1 === null || y1 === undefined || x1 === undefined) return null
    return y0 + ((y1 - y0) * (at - x0)) / (x1 - x0)
  }
  if (first > 0 && x[first - 1] === low) {
    cut.x.unshift(low)
    cut.y.unshift(y[first - 1] ?? null)
  } else if (first > 0 && first < x.length) {
    cut.x.unshift(low)
    cut.y.unshift(cross(first, low))
  }
  if (last > 0 && last < x.length && x[last - 1] !== high) {
    cut.x.push(high)
    cut.y.push(cross(last, high))
  }
  return cut
}

/** First, least, most and last point of every column of pixels: looks the same as all of them. */
export function thinned(curve: Curve, column: (x: number) => number): Curve {
  const kept: number[] = []
  const { x, y } = curve
  for (let from = 0; from < x.length; ) {
    const at = Math.round(column(x[from] as number))
    let [to, least, most] = [from, from, from]
    while (to < x.length && Math.round(column(x[to] as number)) === at) {
      if ((y[to] ?? Infinity) < (y[least] ?? Infinity)) least = to
      if ((y[to] ?? -Infinity) > (y[most] ?? -Infinity)) most = to
      to++
    }
    kept.push(...new Set([from, Math.min(least, most), Math.max(least, most), to - 1]))
    from = to
  }
  return { x: kept.map((k) => x[k] as number), y: kept.map((k) => y[k] ?? null) }
}

/** Path of a curve; it is broken where there is no value, or none that the axis can show. */
export function pathOf(curve: Curve, at: (x: number) => number, height: (y: number) => number, steps: boolean): string {
  let path = ''
  let on = false
  curve.x.forEach((x, k) => {
    const v = curve.y[k]
    const h = v === null || v === undefined ? NaN : height(v)
    if (!Number.isFinite(h)) return void (on = false)
    const [px, py] = [at(x).toFixed(1), h.toFixed(1)]
    path += on ? (steps ? `H${px}V${py}` : `L${px} ${py}`) : `M${px} ${py}`
    on = true
  })
  return path
}
