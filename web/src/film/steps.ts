/** The steps of a film beside what the balance showed after each of them. */
import type { FilmHead, Tick } from '../api/types'

/** The spoonfuls of a dose as the service numbers them: each begins with a reading before its first step; one without a step is none. */
export function spoonfulsOf(ticks: Tick[]): Tick[][] {
  const groups: Tick[][] = []
  for (const tick of ticks) {
    const group = groups.at(-1)
    if (group && tick.step > 0 && (tick.spoonful ?? 1) === (group[0]!.spoonful ?? 1)) group.push(tick)
    else groups.push([tick])
  }
  return groups.filter((group) => group.length > 1)
}

export interface FilmRow {
  /** 1 for the first; none for the way back to level. */
  number: number | null
  begins: number
  pitch: number
  shake: number
  strokes: number
  fell: number
  spoon: number
  vial: number
  /** By the balance, since the spoonful began; null where it was not read. */
  shown: number | null
  shownFell: number | null
}

/** One row for each step; `ticks` are those of the same spoonful. */
export function rowsOf(head: FilmHead, ticks: Tick[]): FilmRow[] {
  const mass = (k: number) => ticks[k]?.reading.mass_mg
  const zero = mass(0)
  return head.steps.map((s, k) => {
    const isLevel = k === head.steps.length - 1
    const [before, after] = [mass(k), isLevel ? undefined : mass(k + 1)]
    return {
      number: isLevel ? null : k + 1,
      begins: s.begins_s,
      pitch: s.pitch_deg,
      shake: s.shake_mm,
      strokes: s.shake_mm > 0 ? s.strokes : 0,
      fell: s.fell_mg,
      spoon: s.spoon_mg,
      vial: s.vial_mg,
      shown: after === undefined || zero === undefined ? null : after - zero,
      shownFell: after === undefined || before === undefined ? null : after - before,
    }
  })
}
