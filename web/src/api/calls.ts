/** Every call the page makes, through the client generated from openapi.json. A refusal is thrown as a {@link Problem}. */
import createClient, { type Middleware } from 'openapi-fetch'
import type { Query } from '../resource.svelte'
import { settings, type Holder } from '../settings.svelte'
import { gated } from './gate'
import { Problem } from './problem'
import type { paths } from './schema'
import type * as T from './types'

const client = createClient<paths>({ fetch: gated })

const authorize: Middleware = {
  onRequest({ request }) {
    if (settings.token) request.headers.set('authorization', `Bearer ${settings.token}`)
    return request
  },
}
client.use(authorize)

/** The body of a response, or the problem it reports. */
async function body<D>(answer: Promise<{ data?: D; error?: unknown; response: Response }>): Promise<D> {
  const { data, error, response } = await answer
  if (!response.ok || data === undefined) throw Problem.from(error, response)
  return data
}

/** What a refusal in {@link whoHolds} reports about the token. */
const HELD = /the token has (viewer|operator)\b/
/** The role of this token; an unknown token is refused. The service lists tokens for admins only, and tells everyone else their role. */
export async function whoHolds(token: string): Promise<Holder | undefined> {
  const response = await fetch('/v1/tokens?limit=1', { headers: { authorization: `Bearer ${token}` }, cache: 'no-store' })
  if (response.ok) return { role: 'admin' }
  const problem = Problem.from(await response.json().catch(() => undefined), response)
  if (![403, 405].includes(response.status)) throw problem
  const role = HELD.exec(problem.detail)?.[1]
  return role ? { role } : undefined
}

const at = (id: string) => ({ path: { id } })

export const powders = (query: Query = {}) => body(client.GET('/v1/powders', { params: { query } }))
export const powder = (id: string) => body(client.GET('/v1/powders/{id}', { params: at(id) }))
export const createPowder = (powder: T.NewPowder) => body(client.POST('/v1/powders', { body: powder }))
export const addMeasurement = (powder: string, measurement: T.NewMeasurement) =>
  body(client.POST('/v1/powders/{id}/measurements', { params: at(powder), body: measurement }))
/** Everything measured for a powder, as a file that the import reads. */
export const measurementsCsv = (powder: string): Promise<string> =>
  body(client.GET('/v1/powders/{id}/measurements.csv', { params: at(powder), parseAs: 'text' }))
/** All of a CSV file or nothing; with `create`, powders not yet registered are registered. */
export const importMeasurements = (csv: string, create: boolean) =>
  body(client.POST('/v1/measurements/import', { params: { query: { create } }, body: csv, bodySerializer: (text) => text, headers: { 'content-type': 'text/csv' } }))

export const calibrations = (query: Query = {}) => body(client.GET('/v1/calibrations', { params: { query } }))
export const calibration = (id: string) => body(client.GET('/v1/calibrations/{id}', { params: at(id) }))
export const trials = (id: string, query: Query) => body(client.GET('/v1/calibrations/{id}/trials', { params: { ...at(id), query } }))
export const posterior = (id: string) => body(client.GET('/v1/calibrations/{id}/posterior', { params: at(id) }))
/** Two calibrations that have succeeded, side by side. */
export const comparison = (id: string, other: string) =>
  body(client.GET('/v1/calibrations/{id}/compare', { params: { ...at(id), query: { with: other } } }))
export const startCalibration = (request: T.CalibrationRequest) => body(client.POST('/v1/calibrations', { body: request }))

export const reposes = (query: Query = {}) => body(client.GET('/v1/repose-measurements', { params: { query } }))
export const repose = (id: string) => body(client.GET('/v1/repose-measurements/{id}', { params: at(id) }))
/** A request without a run number starts a new one each time. */
export const startRepose = (request: T.ReposeRequest) => body(client.POST('/v1/repose-measurements', { body: request }))
/** URL of a part of a raw frame. */
export const rawFrame = (id: string, pile: number, frame: number, part: 'depth' | 'colour' | 'description') => `/v1/repose-measurements/${id}/piles/${pile}/frames/${frame}/${part}`

export const trainings = (query: Query = {}) => body(client.GET('/v1/trainings', { params: { query } }))
export const training = (id: string) => body(client.GET('/v1/trainings/{id}', { params: at(id) }))
export const episodes = (id: string, query: Query) => body(client.GET('/v1/trainings/{id}/episodes', { params: { ...at(id), query } }))
export const startTraining = (request: T.TrainingRequest) => body(client.POST('/v1/trainings', { body: request }))

export const policies = (query: Query = {}) => body(client.GET('/v1/policies', { params: { query } }))
export const policy = (id: string) => body(client.GET('/v1/policies/{id}', { params: at(id) }))
/** The safetensors file. */
export const policyWeights = (id: string): Promise<Blob> =>
  body(client.GET('/v1/policies/{id}/weights', { params: at(id), parseAs: 'blob' })) as Promise<unknown> as Promise<Blob>

export const evaluations = (query: Query = {}) => body(client.GET('/v1/evaluations', { params: { query } }))
export const evaluation = (id: string) => body(client.GET('/v1/evaluations/{id}', { params: at(id) }))
export const startEvaluation = (request: T.EvaluationRequest) => body(client.POST('/v1/evaluations', { body: request }))

export const investigations = (query: Query = {}) => body(client.GET('/v1/investigations', { params: { query } }))
export const investigation = (id: string) => body(client.GET('/v1/investigations/{id}', { params: at(id) }))
export const startInvestigation = (request: T.InvestigationRequest) => body(client.POST('/v1/investigations', { body: request }))
/** The report as the service renders it, for this page's style. */
export const reportSections = (id: string): Promise<string> =>
  body(client.GET('/v1/investigations/{id}/report.html', { params: { ...at(id), query: { fragment: true } }, parseAs: 'text' }))
/** Predictions of the simulator for every row of the file, before and after. */
export const predictions = (id: string): Promise<string> => body(client.GET('/v1/investigations/{id}/predict.csv', { params: at(id), parseAs: 'text' }))

export const simulators = (query: Query = {}) => body(client.GET('/v1/simulators', { params: { query } }))
export const currentSimulator = () => body(client.GET('/v1/simulators/current'))
/** Makes a version or the base current. Repeating the request changes nothing. */
export const chooseSimulator = (simulator: string) => body(client.PUT('/v1/simulators/current', { body: { simulator } }))

export type WeighingsQuery = NonNullable<paths['/v1/weighings']['get']['parameters']['query']>
export const weighings = (query: WeighingsQuery = {}) => body(client.GET('/v1/weighings', { params: { query } }))
export const weighing = (id: string) => body(client.GET('/v1/weighings/{id}', { params: at(id) }))
/** No response within this time leaves it unknown whether a dose was accepted. */
const WEIGHING_MS = 20_000
/** The same key with the same request never pours twice; `before`: it had already been accepted. */
export async function startWeighing(request: T.WeighingRequest, key: string) {
  const answer = await client.POST('/v1/weighings', { params: { header: { 'Idempotency-Key': key } }, body: request, signal: AbortSignal.timeout(WEIGHING_MS) })
  return { id: (await body(Promise.resolve(answer))).id, before: answer.response.headers.get('idempotency-replayed') === 'true' }
}

/** How a powder leaves the spoon, from all its shakes. */
export const powderCard = (id: string) => body(client.GET('/v1/powders/{id}/card', { params: at(id) }))
/** Starts a probing run; the id of its weighing. The same key never pours twice. */
export async function characterise(request: T.CharacterisationRequest, key: string): Promise<string> {
  const answer = client.POST('/v1/characterisations', { params: { header: { 'Idempotency-Key': key } }, body: request, signal: AbortSignal.timeout(WEIGHING_MS) })
  return (await body(answer)).id
}

/** A person confirms the vial that a dose is waiting for. */
export const vialReady = (id: string, said: T.VialReadyRequest) => body(client.POST('/v1/weighings/{id}/vial-ready', { params: at(id), body: said }))

/** A service that does not answer this within a few seconds counts as not responding. */
const BENCH_MS = 4000
export const bench = () => body(client.GET('/v1/bench', { signal: AbortSignal.timeout(BENCH_MS) }))
/** After a stop or a cleared latch: waiting doses may start. */
export const resumeBench = (said: T.ResumeRequest) => body(client.POST('/v1/bench/resume', { body: said }))
export const clearBench = (said: T.ClearRequest) => body(client.POST('/v1/bench/clear', { body: said }))
export const checkRepeatability = (weighed: T.RepeatabilityRequest) => body(client.POST('/v1/bench/repeatability', { body: weighed }))

/** Newest first. */
export const audit = (query: Query = {}) => body(client.GET('/v1/audit', { params: { query } }))
/** Checks the whole record; with `hash`, also reports whether it contains that hash. */
export const verifyAudit = (hash?: string) => body(client.GET('/v1/audit/verification', { params: { query: { hash } } }))

export const jobs = (query: Query & { kind?: T.JobKind; state?: T.JobState } = {}) => body(client.GET('/v1/jobs', { params: { query } }))
export const cancelJob = (id: string) => body(client.POST('/v1/jobs/{id}/cancel', { params: at(id) }))
