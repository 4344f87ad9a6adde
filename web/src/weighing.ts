/** How a weighing is told: its badge, its decimals, the order of its states. */
import type { Weighing } from './api/types'
import { decimalsFor } from './format'

/** The outcome once there is one, the state before. */
export function verdict(w: Weighing): string {
  return w.outcome ?? w.state
}

/** Nothing more will happen. */
export function ended(w: Weighing): boolean {
  return ['done', 'aborted', 'unknown'].includes(w.state)
}

/** Decimals of a reading, taken from the finest step seen: a 1 mg balance shows none. */
export function readingDecimals(readings: (number | null | undefined)[]): number {
  const seen = readings.filter((r): r is number => typeof r === 'number')
  for (const step of [1, 0.1, 0.01]) if (seen.every((r) => Math.abs(r / step - Math.round(r / step)) < 1e-6)) return decimalsFor(step)
  return 3
}

/** The true mass is known in simulation only; it is written one decimal finer than the balance reads. */
export const TRUE_DECIMALS = 2
