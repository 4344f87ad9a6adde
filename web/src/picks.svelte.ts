/** What a reader has picked in the lists to compare, by kind; kept while this tab is open, so that picks from several lists add up. */
import { link } from './route.svelte'

/** Kinds that can be compared: the name of their view, and the word for one and for several. */
export const COMPARED = {
  calibrations: ['calibration', 'calibrations'],
  trainings: ['training', 'trainings'],
  policies: ['policy', 'policies'],
  evaluations: ['evaluation', 'evaluations'],
  weighings: ['dose', 'doses'],
} as const
export type ComparedKind = keyof typeof COMPARED

/** Most that can still be told apart in one drawing. */
export const MOST = 20

const KEY = 'flip-picks'

function kept(): Record<string, string[]> {
  try {
    return (JSON.parse(sessionStorage.getItem(KEY) ?? '{}') as Record<string, string[]> | null) ?? {}
  } catch {
    return {}
  }
}

class Picks {
  #ids = $state.raw(kept())

  of(kind: ComparedKind): string[] {
    return this.#ids[kind] ?? []
  }
  set(kind: ComparedKind, ids: string[]) {
    this.#ids = { ...this.#ids, [kind]: ids.slice(0, MOST) }
    sessionStorage.setItem(KEY, JSON.stringify(this.#ids))
  }
  toggle(kind: ComparedKind, id: string) {
    const ids = this.of(kind)
    this.set(kind, ids.includes(id) ? ids.filter((other) => other !== id) : [...ids, id])
  }
}

export const picks = new Picks()

/** The address of a comparison. */
export const compareLink = (kind: ComparedKind, ids: string[]) => link(['compare', kind], new URLSearchParams({ ids: ids.join(',') }))
