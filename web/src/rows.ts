/** Which rows of a long table are drawn. Heights are px; a row not yet drawn counts with the usual height. */

/** Tables up to this many rows are drawn whole. */
export const WHOLE_MAX = 60
/** Rows come and go this many at a time, and as many are drawn beyond either edge: each of them costs time at every step of scrolling. */
const STEP = 4

export class Rows {
  #heights = new Map<string, number>()
  #usual: number | undefined

  constructor(private readonly assumed = 32) {}

  /** The top of every row, named by its key, from the first one's, and the bottom of the last. */
  tops(keys: string[]): Float64Array {
    const usual = this.#usual ?? this.assumed
    const tops = new Float64Array(keys.length + 1)
    keys.forEach((key, k) => (tops[k + 1] = tops[k]! + (this.#heights.get(key) ?? usual)))
    return tops
  }

  /** Takes the heights of rows that are drawn; whether that moves any row. */
  measured(drawn: [key: string, height: number][]): boolean {
    const seen = drawn.filter(([, height]) => height > 0)
    let moved = false
    if (this.#usual === undefined && seen.length > 0) {
      this.#usual = seen.map(([, height]) => height).sort((a, b) => a - b)[seen.length >> 1]!
      moved = this.#usual !== this.assumed
    }
    for (const [key, height] of seen) {
      if (Math.abs((this.#heights.get(key) ?? this.#usual ?? 0) - height) < 0.1) continue
      this.#heights.set(key, height)
      moved = true
    }
    return moved
  }
}

/** The row at this height: the last whose top is not below it. */
export function rowAt(tops: Float64Array, y: number): number {
  let [low, high] = [0, Math.max(0, tops.length - 2)]
  while (low < high) {
    const middle = (low + high + 1) >> 1
    if (tops[middle]! <= y) low = middle
    else high = middle - 1
  }
  return low
}

/** First row to draw, and the one after the last, where `height` px are seen from `top`. */
export function drawnRows(tops: Float64Array, top: number, height: number): [number, number] {
  const count = tops.length - 1
  const first = Math.floor(rowAt(tops, top) / STEP) * STEP - STEP
  const last = Math.ceil((rowAt(tops, top + height) + 1) / STEP) * STEP + STEP
  return [Math.max(0, Math.min(first, count)), Math.min(count, last)]
}
