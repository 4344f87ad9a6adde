/** Investigations as the service has them, until openapi.json describes them: then `types.ts` takes these names from the schema and this file goes. */
import type { components, operations } from './schema'

type Schemas = components['schemas']

export type Verdict = 'no_discrepancy' | 'cause' | 'ambiguous' | 'unexplained'

export interface PowderEffect {
  powder: string
  effect: number
  ci95: number[]
}
export interface Finding {
  channel: 'repose' | 'flow_time' | 'trace' | 'scatter'
  covariate?: string | null
  powders: string[]
  effect: number
  ci95: number[]
  unit: string
  span: string
  by_powder: PowderEffect[]
}
export interface FittedParameter {
  name: string
  value: number
  ci95: number[]
  unit: string
}
export interface Cause {
  mechanism: string
  family: string
  inclusion_probability: number
  confidence_level: number
  parameters: FittedParameter[]
  powders: string[]
}
export interface Experiment {
  what: string
  runs: Record<string, string>[]
  minutes: number
  chance_of_resolution: number
  expected_posterior: number
}
export interface HeldOut {
  rmse_before: number
  rmse_after: number
  ci95: number[]
  unit: string
  n: number
}
export interface Gain {
  held_out: HeldOut
  by_powder?: HeldOut | null
  by_range?: HeldOut | null
  log_score: { before: number; after: number; ci95: number[] }
  coverage90: { before: number; after: number }
  weighing_error_mg?: { before: number; after: number; sham: number; oracle?: number | null; ci95: number[] } | null
  accepted: boolean
}
export interface Evidence {
  cause: string
  family?: string | null
  log10_evidence: number
  inclusion_probability: number
}
export interface Predicted {
  row: number
  powder: string
  measured_deg?: number | null
  before_deg?: number | null
  before_sd_deg: number
  after_deg?: number | null
  after_sd_deg: number
}
export interface Curve {
  covariate: string
  levels: string[]
  at: (number | null)[]
  /** Place, mean and half width of the 90 % band. */
  course: number[][]
}
export interface Report {
  schema_version: number
  sentence: string
  verdict: Verdict
  p_value: number
  findings: Finding[]
  causes: Cause[]
  ambiguous_between: string[]
  unexplained?: { covariate?: string | null; law: string; form_class: string } | null
  suggested_experiment?: Experiment | null
  simulator_version: { base: string; extended?: string | null; verified: boolean }
  gain?: Gain | null
  minimum_detectable: { mechanism: string; effect_deg: number; power: number }[]
  blind_spots: string[]
  evidence: Evidence[]
  untestable: { mechanism: string; reason: string }[]
  null_check: { campaigns: number; statistic: number; threshold95: number }
  rows: Predicted[]
  curves: Curve[]
  simulator_runs: number
  wall_s: number
}
export interface Investigation {
  job: Schemas['Job']
  settings: { seed: number; simulations: number }
  result?: Report | null
}
export interface InvestigationRequest {
  measurements_csv: string
  seed?: number
  simulations?: number
}

type Answer<Type extends string, Body> = { headers: Record<string, unknown>; content: Record<Type, Body> }
type Page = { items: Investigation[]; next?: string | null }
type OfOne = { query?: never; header?: never; path: { id: string }; cookie?: never }
type None = { query?: never; header?: never; path?: never; cookie?: never }

/** Beside the paths of the schema. */
export interface InvestigationPaths {
  '/v1/investigations': {
    get: { parameters: operations['list_evaluations']['parameters']; requestBody?: never; responses: { 200: Answer<'application/json', Page> } }
    post: { parameters: None; requestBody: { content: { 'application/json': InvestigationRequest } }; responses: { 202: Answer<'application/json', Schemas['Job']> } }
  }
  '/v1/investigations/{id}': { get: { parameters: OfOne; requestBody?: never; responses: { 200: Answer<'application/json', Investigation> } } }
  '/v1/investigations/{id}/predict.csv': { get: { parameters: OfOne; requestBody?: never; responses: { 200: Answer<'text/csv', string> } } }
}
