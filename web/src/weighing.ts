/** How a weighing is presented: its badge, its decimals, the order of its states. */
import type { Weighing } from './api/types'
import { decimalsFor } from './format'

/** The outcome once there is one, the state before that; `unproven` if it is within tolerance, but by less than its uncertainty. */
export function verdict(w: Weighing): string {
  return w.outcome === 'within' && w.measured?.proven === false ? 'unproven' : (w.outcome ?? w.state)
}

/** The final reading, mg: the one number that verdict, error, gauge and means use. An aborted dose has none. */
export function readingOf(w: Weighing): number | null {
  return ['aborted', 'unknown'].includes(w.outcome ?? w.state) ? null : (w.reading_mg ?? null)
}

/** How far the reading is from the target, mg; a probing run has none. */
export function errorOf(w: Weighing): number | null {
  const reading = ended(w) && !w.asked?.probe ? readingOf(w) : null
  return reading === null ? null : reading - w.target_mg
}

/** It finished on its own, with a final reading: only such doses show how well the bench weighs. */
export function counts(w: Weighing): boolean {
  return w.outcome !== 'stopped' && errorOf(w) !== null
}

/** Expanded uncertainty of the reading, mg. */
export function uncertaintyOf(w: Weighing): number | null {
  return w.measured?.uncertainty_mg ?? null
}

/** The dose is waiting: nothing has moved for it yet. */
export function waits(w: Weighing): boolean {
  return ['planned', 'awaiting_vial'].includes(w.state)
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

/** Smallest net mass that may be called accurately weighed (USP <41>), mg. */
export function minimumWeight(sd_mg: number, readability_mg: number): number {
  return (2 * Math.max(sd_mg, 0.41 * readability_mg)) / 0.001
}

/** Readings that a person typed or pasted, and the first piece that is not a number. A comma is ambiguous, so it is refused. */
export function readingsIn(text: string): { readings: number[]; wrong?: string } {
  const pieces = text.split(/[\s;]+/).filter(Boolean)
  return { readings: pieces.map(Number), wrong: pieces.find((piece) => !/^[+-]?\d+(\.\d+)?$/.test(piece)) }
}
