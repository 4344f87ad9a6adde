/** Which parameters differ most between calibrations: the means over their sets, beside the prior and beside the spread of the sets. */
import type { ParameterSet } from '../api/types'
import { mean, sd } from '../format'
import { PARAMETERS } from '../parts/SetTable.svelte'

export interface Ranked {
  key: string
  label: string
  unit?: string
  /** One for each calibration; null without sets. */
  means: (number | null)[]
  sds: (number | null)[]
  /** The greatest less the least mean, as a share of the width of the prior. */
  ofPrior: number | null
  /** The same, in standard deviations of the sets within a calibration; null if none has two. */
  inSds: number | null
}

/** The most different first. */
export function ranked(calibrations: ParameterSet[][]): Ranked[] {
  const rows = PARAMETERS.map(({ key, label, unit, lower, upper }): Ranked => {
    const values = calibrations.map((sets) => sets.map((set) => set[key]))
    const [means, sds] = [values.map(mean), values.map(sd)]
    const known = means.filter((m) => m !== null)
    const range = known.length < 2 ? null : Math.max(...known) - Math.min(...known)
    const spread = mean(sds.filter((s) => s !== null).map((s) => s * s))
    return { key, label, unit, means, sds, ofPrior: range === null ? null : range / (upper - lower), inSds: range === null || !spread ? null : range / Math.sqrt(spread) }
  })
  return rows.sort((a, b) => (b.ofPrior ?? -1) - (a.ofPrior ?? -1))
}
