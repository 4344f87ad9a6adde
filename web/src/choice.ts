/** The version of the simulator that a request names, its conditions, and what computes. */
import type { Device } from './api/types'

export interface Choice {
  /** `base`, or a version. */
  version: string
  /** As typed, by name. */
  conditions: Record<string, string>
}

export const NO_CHOICE: Choice = { version: 'base', conditions: {} }

/** The fields of a request: none for the base. */
export function bySimulator({ version, conditions }: Choice) {
  if (version === NO_CHOICE.version) return {}
  const given = Object.entries(conditions).filter(([, value]) => value !== '')
  const typed = (value: string) => (Number.isFinite(Number(value)) ? Number(value) : value)
  return { simulator: version, conditions: Object.fromEntries(given.map(([name, value]) => [name, typed(value)])) }
}

/** The field of a request: none for the processor. */
export const onDevice = (device: Device) => (device === 'cpu' ? {} : { device })
