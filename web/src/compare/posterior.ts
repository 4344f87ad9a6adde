/** Posteriors as drawn: against a prior that is level between the published bounds. */

/** Bins of a histogram between the bounds. */
export const BINS = 16

/** Height of each bin relative to the prior: 1 where nothing was learnt. */
export function density(draws: number[], lower: number, upper: number): number[] {
  const counts = Array.from({ length: BINS }, () => 0)
  for (const v of draws) {
    const bin = Math.min(BINS - 1, Math.max(0, Math.floor(((v - lower) / (upper - lower)) * BINS)))
    counts[bin] = (counts[bin] as number) + 1
  }
  return counts.map((n) => (draws.length > 0 ? (n * BINS) / draws.length : 0))
}

/** Pearson correlation; null where one of them does not vary. */
export function correlation(a: number[], b: number[]): number | null {
  const n = Math.min(a.length, b.length)
  if (n < 2) return null
  const mean = (v: number[]) => v.slice(0, n).reduce((s, x) => s + x, 0) / n
  const [ma, mb] = [mean(a), mean(b)]
  let [ab, aa, bb] = [0, 0, 0]
  for (let k = 0; k < n; k++) {
    const [da, db] = [(a[k] as number) - ma, (b[k] as number) - mb]
    ab += da * db
    aa += da * da
    bb += db * db
  }
  return aa > 0 && bb > 0 ? ab / Math.sqrt(aa * bb) : null
}
