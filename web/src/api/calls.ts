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
    // Who logs in may have a token that has ended, which would be refused.
    if (request.url.includes('/v1/login')) return request
    if (settings.token && !request.headers.has('authorization')) request.headers.set('authorization', `Bearer ${settings.token}`)
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

const at = (id: string) => ({ path: { id } })

/** Who holds this token; an unknown token is refused. */
export const whoHolds = (token: string): Promise<Holder> =>
  body(client.GET('/v1/me', { headers: { authorization: `Bearer ${token}` }, cache: 'no-store' }))

/** Where people can log in with the lab's own accounts. */
export const logInOffer = () => body(client.GET('/v1/login'))
export const beginLogIn = () => body(client.POST('/v1/login'))
/** A token, as {@link createToken} gives one. */
export const finishLogIn = (answer: T.LogInAnswer) => body(client.POST('/v1/login/finish', { body: answer }))

/** Newest first, ended ones too. For admins. */
export const tokens = (query: Query = {}) => body(client.GET('/v1/tokens', { params: { query } }))
/** Its secret is not shown again. */
export const createToken = (token: T.NewToken) => body(client.POST('/v1/tokens', { body: token }))
export const revokeToken = (id: string) => body(client.DELETE('/v1/tokens/{id}', { params: at(id) }))

/** Which page of a list, and which of its things by their labels. */
export type LabelledQuery = Query & { tag?: string; archived?: 'exclude' | 'only' | 'include' }
export const labels = (query: LabelledQuery = {}) => body(client.GET('/v1/labels', { params: { query } }))
export const label = (kind: T.LabelKind, id: string) => body(client.GET('/v1/labels/{kind}/{id}', { params: { path: { kind, id } } }))
/** What the change leaves out stays as it is. */
export const setLabel = (kind: T.LabelKind, id: string, change: T.LabelChange) => body(client.PUT('/v1/labels/{kind}/{id}', { params: { path: { kind, id } }, body: change }))

export const powders = (query: LabelledQuery = {}) => body(client.GET('/v1/powders', { params: { query } }))
export const powder = (id: string) => body(client.GET('/v1/powders/{id}', { params: at(id) }))
export const createPowder = (powder: T.NewPowder) => body(client.POST('/v1/powders', { body: powder }))
export const addMeasurement = (powder: string, measurement: T.NewMeasurement) =>
  body(client.POST('/v1/powders/{id}/measurements', { params: at(powder), body: measurement }))
/** It stays on the list with the reason; nothing uses it again. */
export const withdrawMeasurement = (powder: string, measurement: string, reason: string) =>
  body(client.POST('/v1/powders/{id}/measurements/{measurement}/withdraw', { params: { path: { id: powder, measurement } }, body: { reason } }))
export const correctMeasurement = (powder: string, measurement: string, correction: T.CorrectMeasurement) =>
  body(client.POST('/v1/powders/{id}/measurements/{measurement}/correct', { params: { path: { id: powder, measurement } }, body: correction }))
/** Everything measured, for one powder or all, as a file that the import reads. */
export const measurementsCsv = (powder?: string): Promise<string> =>
  body(powder ? client.GET('/v1/powders/{id}/measurements.csv', { params: at(powder), parseAs: 'text' }) : client.GET('/v1/measurements.csv', { parseAs: 'text' }))
/** All of a CSV file or nothing; with `create`, powders not yet registered are registered. */
export const importMeasurements = (csv: string, create: boolean) =>
  body(client.POST('/v1/measurements/import', { params: { query: { create } }, body: csv, bodySerializer: (text) => text, headers: { 'content-type': 'text/csv' } }))

export const jobTimes = () => body(client.GET('/v1/jobs/times'))

export const calibrations = (query: LabelledQuery = {}) => body(client.GET('/v1/calibrations', { params: { query } }))
export const calibration = (id: string) => body(client.GET('/v1/calibrations/{id}', { params: at(id) }))
export const trials = (id: string, query: Query) => body(client.GET('/v1/calibrations/{id}/trials', { params: { ...at(id), query } }))
export const posterior = (id: string) => body(client.GET('/v1/calibrations/{id}/posterior', { params: at(id) }))
/** Two calibrations that have succeeded, side by side. */
export const comparison = (id: string, other: string) =>
  body(client.GET('/v1/calibrations/{id}/compare', { params: { ...at(id), query: { with: other } } }))
export const startCalibration = (request: T.CalibrationRequest) => body(client.POST('/v1/calibrations', { body: request }))

export const reposes = (query: LabelledQuery = {}) => body(client.GET('/v1/repose-measurements', { params: { query } }))
export const repose = (id: string) => body(client.GET('/v1/repose-measurements/{id}', { params: at(id) }))
/** A request without a run number starts a new one each time. */
export const startRepose = (request: T.ReposeRequest) => body(client.POST('/v1/repose-measurements', { body: request }))
/** URL of a part of a raw frame. */
export const rawFrame = (id: string, pile: number, frame: number, part: 'depth' | 'colour' | 'description') => `/v1/repose-measurements/${id}/piles/${pile}/frames/${frame}/${part}`

export const trainings = (query: LabelledQuery = {}) => body(client.GET('/v1/trainings', { params: { query } }))
export const training = (id: string) => body(client.GET('/v1/trainings/{id}', { params: at(id) }))
export const episodes = (id: string, query: Query) => body(client.GET('/v1/trainings/{id}/episodes', { params: { ...at(id), query } }))
export const startTraining = (request: T.TrainingRequest) => body(client.POST('/v1/trainings', { body: request }))

export const policies = (query: LabelledQuery = {}) => body(client.GET('/v1/policies', { params: { query } }))
export const policy = (id: string) => body(client.GET('/v1/policies/{id}', { params: at(id) }))
/** The safetensors file. */
export const policyWeights = (id: string): Promise<Blob> =>
  body(client.GET('/v1/policies/{id}/weights', { params: at(id), parseAs: 'blob' })) as Promise<unknown> as Promise<Blob>

export const evaluations = (query: LabelledQuery = {}) => body(client.GET('/v1/evaluations', { params: { query } }))
export const evaluation = (id: string) => body(client.GET('/v1/evaluations/{id}', { params: at(id) }))
export const startEvaluation = (request: T.EvaluationRequest) => body(client.POST('/v1/evaluations', { body: request }))

export const investigations = (query: LabelledQuery = {}) => body(client.GET('/v1/investigations', { params: { query } }))
export const investigation = (id: string) => body(client.GET('/v1/investigations/{id}', { params: at(id) }))
export const startInvestigation = (request: T.InvestigationRequest) => body(client.POST('/v1/investigations', { body: request }))
/** The report as the service renders it, for this page's style. */
export const reportSections = (id: string): Promise<string> =>
  body(client.GET('/v1/investigations/{id}/report.html', { params: { ...at(id), query: { fragment: true } }, parseAs: 'text' }))
/** Predictions of the simulator for every row of the file, before and after. */
export const predictions = (id: string): Promise<string> => body(client.GET('/v1/investigations/{id}/predict.csv', { params: at(id), parseAs: 'text' }))

export const simulators = (query: LabelledQuery = {}) => body(client.GET('/v1/simulators', { params: { query } }))
export const currentSimulator = () => body(client.GET('/v1/simulators/current'))
/** Makes a version or the base current, for this reason. Repeating the request changes nothing. */
export const chooseSimulator = (simulator: string, reason: string) => body(client.PUT('/v1/simulators/current', { body: { simulator, reason } }))

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

/** What a list of doses means; nothing is stored. */
export const checkDoseList = (request: T.DoseListRequest) => body(client.POST('/v1/weighings/list', { body: { ...request, check: true } }))
/** Plans all doses of a list, or none. The same key with the same list never pours twice. */
export const startDoseList = (request: T.DoseListRequest, key: string) => body(client.POST('/v1/weighings/list', { params: { header: { 'Idempotency-Key': key } }, body: request, signal: AbortSignal.timeout(WEIGHING_MS) }))

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
/** What a person checks before a dose. */
export const checklist = () => body(client.GET('/v1/bench/checklist'))
export const changeChecklist = (items: string[]) => body(client.PUT('/v1/bench/checklist', { body: { items } }))
export const checkRepeatability = (weighed: T.RepeatabilityRequest) => body(client.POST('/v1/bench/repeatability', { body: weighed }))

/** Newest first. */
export type AuditQuery = NonNullable<paths['/v1/audit']['get']['parameters']['query']>
export const audit = (query: AuditQuery = {}) => body(client.GET('/v1/audit', { params: { query } }))
/** Checks the whole record; with `hash`, also reports whether it contains that hash. */
export const verifyAudit = (hash?: string) => body(client.GET('/v1/audit/verification', { params: { query: { hash } } }))

/** Films, newest first: of a weighing's spoonfuls, a parameter set's heaps, or a training's episodes. */
export const films = (query: Query & { weighing?: string; set?: string; training?: string } = {}) => body(client.GET('/v1/films', { params: { query } }))
export const film = (id: string) => body(client.GET('/v1/films/{id}', { params: at(id) }))
/** The same request returns the film that was made before. */
export const startFilm = (request: T.FilmRequest) => body(client.POST('/v1/films', { body: request }))
/** The file with a film's grains. */
export const filmGrains = (id: string): Promise<ArrayBuffer> =>
  body(client.GET('/v1/films/{id}/grains', { params: at(id), parseAs: 'arrayBuffer' })) as Promise<unknown> as Promise<ArrayBuffer>

export const jobs = (query: LabelledQuery & { kind?: T.JobKind; state?: T.JobState; label?: string } = {}) => body(client.GET('/v1/jobs', { params: { query } }))
/** The processes that compute them; a service that does not answer within this time counts as not responding. */
export const workers = (patience_ms: number) => body(client.GET('/v1/workers', { signal: AbortSignal.timeout(patience_ms) }))
/** The benches of all servers, likewise. */
export const benches = (patience_ms: number) => body(client.GET('/v1/benches', { signal: AbortSignal.timeout(patience_ms) }))
export const cancelJob = (id: string) => body(client.POST('/v1/jobs/{id}/cancel', { params: at(id) }))
/** The same inputs as a failed or cancelled job, as a new job; `cpu`: on the processor instead of a card. */
export const startAgain = (id: string, device?: 'cpu') => body(client.POST('/v1/jobs/{id}/again', { params: { ...at(id), query: { device } } }))
