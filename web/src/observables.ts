/** Words for measurements other than the angle of repose. */
import type { Observation } from './api/types'
import { NONE } from './format'

const UNITS: Record<Observation['observable']['kind'], string> = { flow_time: 's', shake_mass: 'mg', drained_angle: '°', pile_height: 'mm' }

export const unitOf = (observation: Observation) => UNITS[observation.observable.kind]

/** The settings of its experiment. */
export const settingsOf = ({ observable: { kind: _, ...rest } }: Observation) => Object.entries(rest).map(([key, value]) => `${key} ${value}`).join(', ') || NONE
