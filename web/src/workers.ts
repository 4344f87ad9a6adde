/** Which of the processes that compute are at work. */
import type { Worker } from './api/types'

/** They are asked for at least this often: that one is lost, no event says. */
export const EVERY_MS = 10_000
/** One not heard of for longer is lost. */
const LOST_MS = 30_000

/** How long ago something was, by the clock of those that compute, not the browser's, ms. */
export function clock(all: Worker[]) {
  const newest = Math.max(...all.map((w) => Date.parse(w.heard_at)))
  return (at: string) => newest - Date.parse(at)
}

/** Those that ended without saying so. */
export function lost(all: Worker[]) {
  const ago = clock(all)
  return all.filter((w) => !w.ended_at && ago(w.heard_at) > LOST_MS)
}

/** The graphics cards that jobs can be computed on, each name once. */
export function cards(all: Worker[]) {
  const away = new Set(lost(all))
  return [...new Set(all.filter((w) => !w.ended_at && !away.has(w)).flatMap((w) => w.card ?? []))]
}
