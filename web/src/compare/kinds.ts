/** What is read of each kind that can be compared, and what is known about it. */
import { calibration, episodes, evaluation, evaluations, policy, posterior, training, trials, weighing } from '../api/calls'
import type { Calibration, Episode, Evaluation, Label, Policy, Posterior, Tick, Training, Trial, Weighing } from '../api/types'
import { flat } from '../flat'
import { duration, NONE, num, signed, significant, words } from '../format'
import { methodName } from '../methods'
import { powderName } from '../names.svelte'
import { badgeText } from '../parts/Badge.svelte'
import { PARAMETERS } from '../parts/SetTable.svelte'
import { all, SERIES } from '../resource.svelte'
import type { ComparedKind } from '../picks.svelte'
import { ended, errorOf, readingOf, TRUE_DECIMALS, uncertaintyOf, verdict } from '../weighing'
import type { Fact } from './differs'

export interface CalibrationRead {
  calibration: Calibration
  trials: Trial[]
  posterior?: Posterior
}
export interface TrainingRead {
  training: Training
  episodes: Episode[]
}
export interface PolicyRead {
  policy: Policy
  /** The newest evaluation of it that has a result. */
  evaluation?: Evaluation
}
export interface DoseRead {
  weighing: Weighing
  ticks: Tick[]
  label?: Label | null
}
export interface Reads {
  calibrations: CalibrationRead
  trainings: TrainingRead
  policies: PolicyRead
  evaluations: Evaluation
  weighings: DoseRead
}

/** How a kind is read and described. */
export interface Kind<T> {
  read: (id: string) => Promise<T>
  /** The name that it was given, or a few words that tell it from others, as far as they can. */
  name: (it: T) => string
  /** When it was made, ISO. */
  at: (it: T) => string
  state: (it: T) => string
  ended: (it: T) => boolean
  facts: (it: T) => Fact[]
}

const result = (name: string, text: string): Fact => ({ part: 'Result', name, text })
const input = (name: string, text: string | null | undefined): Fact => ({ part: 'Input', name, text: text || NONE })
/** Digits beyond those that anyone typed say nothing. */
const rounded = (text: string) => (/^-?\d+\.\d{9,}$/.test(text) ? String(Number(Number(text).toPrecision(9))) : text)
const settings = (value: unknown): Fact[] => flat(value).map(([name, text]) => ({ part: 'Setting', name, text: rounded(text) }))
const over = (job: { state: string }) => ['succeeded', 'failed', 'cancelled'].includes(job.state)
const took = (job: { started_at?: string | null; finished_at?: string | null }) => (job.started_at && job.finished_at ? (Date.parse(job.finished_at) - Date.parse(job.started_at)) / 1000 : null)
const share = (value: number | null | undefined) => num(value == null ? null : 100 * value, 0)
const range = (values: number[]) => (values.length > 0 ? `${significant(Math.min(...values))} to ${significant(Math.max(...values))}` : NONE)

const calibrations: Kind<CalibrationRead> = {
  read: async (id) => {
    const [it, rows] = await Promise.all([calibration(id), all((q) => trials(id, q), SERIES)])
    return { calibration: it, trials: rows, posterior: it.result?.posterior ? await posterior(id) : undefined }
  },
  name: ({ calibration: c }) => c.label?.name || `${c.powder ? powderName(c.powder) : `${num(c.target.repose_deg)}°`}, ${methodName(c.settings.method ?? 'sequential').toLowerCase()}, seed ${String(c.settings.seed ?? NONE)}`,
  at: ({ calibration: c }) => c.job.created_at,
  state: ({ calibration: c }) => c.job.state,
  ended: ({ calibration: c }) => over(c.job),
  facts: ({ calibration: c, posterior: p }) => [
    result('Sets found', c.result ? String(c.result.sets.length) : NONE),
    result('Mean verified |error| (°)', num(c.result?.verified_error_deg)),
    result('Mean |error| (°)', num(c.result?.mean_error_deg)),
    result('SD of the sets’ errors (°)', num(c.result?.sd_error_deg)),
    result('Search simulations', c.result ? String(c.result.evaluations) : NONE),
    result('Verification simulations', c.result ? String(c.result.verification_runs) : NONE),
    result('Duration', duration(took(c.job))),
    ...PARAMETERS.map((q) => result(`${q.label} of the sets${q.unit ? ` (${q.unit})` : ''}`, range((c.result?.sets ?? []).map((s) => s.parameters[q.key])))),
    ...PARAMETERS.map((q) => result(`${q.label}, learnt (%)`, num(p && 100 * Math.max(0, p.parameters.find((m) => m.key === q.key)?.learnt ?? 0), 0))),
    input('Powder', c.powder ? powderName(c.powder) : 'Bare angle'),
    input('Target (°)', `${num(c.target.repose_deg)} ± ${num(c.target.sd_deg)}`),
    input('Other measurements', String(c.observations.length)),
    ...settings(c.under ? { ...c.settings, under: c.under } : c.settings),
  ],
}

const trainings: Kind<TrainingRead> = {
  read: async (id) => {
    const [it, rows] = await Promise.all([training(id), all((q) => episodes(id, q), SERIES)])
    return { training: it, episodes: rows }
  },
  name: ({ training: t }) => t.label?.name || `${words(t.order)}, seed ${String(t.settings.seed ?? NONE)}`,
  at: ({ training: t }) => t.job.created_at,
  state: ({ training: t }) => t.job.state,
  ended: ({ training: t }) => over(t.job),
  facts: ({ training: t, episodes: rows }) => [
    result('Final |error| (mg)', num(t.result?.final_error_mg)),
    result('Episodes', String(t.result?.episodes ?? rows.length)),
    result('Policy', t.result?.policy ?? NONE),
    result('Duration', duration(took(t.job))),
    input('Levels', t.levels.map((l) => `${powderName(l.powder)} ${num(l.repose_deg)}°`).join(', ')),
    input('Parameter sets', t.levels.flatMap((l) => l.sets).join(' ')),
    ...settings({ preset: t.preset, order: t.order, ...t.settings, ...(t.under ? { under: t.under } : {}) }),
  ],
}

function scores(e: Evaluation | undefined): Fact[] {
  return (e?.result?.summary ?? []).flatMap((s) => [
    result(`${words(s.controller)}: mean |error| (mg)`, num(s.mae_mg)),
    result(`${words(s.controller)}: 95 % interval (mg)`, s.ci95.map((v) => num(v)).join(' to ')),
    result(`${words(s.controller)}: bias (mg)`, signed(s.bias_mg)),
    result(`${words(s.controller)}: over (%)`, share(s.over_share)),
    result(`${words(s.controller)}: empty (%)`, share(s.zero_share)),
    result(`${words(s.controller)}: shakes`, num(s.shakes_mean, 1)),
    result(`${words(s.controller)}: time (s)`, num(s.seconds_mean, 0)),
  ])
}
function conditions(e: Evaluation): Fact[] {
  return [
    input('Powders', e.powders.map(powderName).join(', ')),
    input('Targets (mg)', e.targets_mg.map((t) => num(t, 1)).join(', ')),
    input('Controllers', e.controllers.map(words).join(', ')),
    ...settings({ repeats: e.repeats, readability_mg: e.readability_mg, max_shakes: e.max_shakes, seed: e.seed, conditions: e.conditions, ...(e.under ? { under: e.under } : {}) }),
  ]
}

/** The shared list of evaluations: read once for all policies of a comparison. */
let listed: { at: number; list: Promise<Evaluation[]> } | undefined
const KEPT_MS = 3000
function evaluationsNow(): Promise<Evaluation[]> {
  if (!listed || Date.now() - listed.at > KEPT_MS) listed = { at: Date.now(), list: all(evaluations) }
  return listed.list
}

/** Sets as their ids: the nine values of each are in its calibration. */
function manifestOf(p: Policy): Record<string, unknown> {
  const { levels, kind: _, final_error_mg: __, ...rest } = p.manifest as { kind?: string; final_error_mg?: number; levels?: { powder: string; episodes?: number; sets?: { id: string }[] }[] }
  return levels ? { ...rest, levels: levels.map((level) => ({ ...level, sets: (level.sets ?? []).map((set) => set.id) })) } : rest
}

const policies: Kind<PolicyRead> = {
  read: async (id) => {
    const [it, tests] = await Promise.all([policy(id), evaluationsNow()])
    return { policy: it, evaluation: tests.find((e) => e.policy === id && e.result) }
  },
  name: ({ policy: p }) => p.label?.name || (p.manifest.order || p.manifest.seed !== undefined ? `${words(p.kind)}, ${[p.manifest.preset, p.manifest.seed === undefined ? '' : `seed ${String(p.manifest.seed)}`].filter(Boolean).join(', ')}` : words(p.kind)),
  at: ({ policy: p }) => p.created_at,
  state: () => 'succeeded',
  ended: () => false,
  facts: ({ policy: p, evaluation: e }) => [
    ...p.evaluated.map((m) => result(`${powderName(m.powder)}: mean |error| over all evaluations (mg)`, num(m.mae_mg))),
    ...scores(e).filter((f) => f.name.startsWith('Policy:')),
    result('Final |error| of the training (mg)', num(p.manifest.final_error_mg as number | undefined)),
    result('Evaluation', e?.job.id ?? NONE),
    input('Kind', words(p.kind)),
    input('Training', p.training),
    ...settings(manifestOf(p)),
  ],
}

const evaluationKind: Kind<Evaluation> = {
  read: evaluation,
  name: (e) => e.label?.name || `${e.policy}, ${e.powders.length} × ${e.targets_mg.length} × ${e.repeats}`,
  at: (e) => e.job.created_at,
  state: (e) => e.job.state,
  ended: (e) => over(e.job),
  facts: (e) => [...scores(e), result('Duration', duration(took(e.job))), input('Policy', e.policy), ...conditions(e)],
}

const weighings: Kind<DoseRead> = {
  read: weighing,
  name: ({ weighing: w, label }) => label?.name || `${powderName(w.powder)}, ${num(w.target_mg, TRUE_DECIMALS)} mg`,
  at: ({ weighing: w }) => w.created_at,
  state: ({ weighing: w }) => verdict(w),
  ended: ({ weighing: w }) => ended(w),
  facts: ({ weighing: w }) => [
    result('Verdict', badgeText(verdict(w))),
    result('Reading (mg)', num(readingOf(w), TRUE_DECIMALS)),
    result('Error (mg)', signed(errorOf(w), TRUE_DECIMALS)),
    result('Expanded uncertainty (mg)', num(uncertaintyOf(w), TRUE_DECIMALS)),
    result('True mass, in simulation (mg)', num(w.dispensed_mg, TRUE_DECIMALS)),
    result('Shakes', w.shakes == null ? NONE : String(w.shakes)),
    result('Duration', duration(w.seconds)),
    input('Powder', powderName(w.powder)),
    input('Target (mg)', num(w.target_mg, TRUE_DECIMALS)),
    input('Tolerance (mg)', `−${num(w.tolerance_lower_mg, TRUE_DECIMALS)} / +${num(w.tolerance_upper_mg, TRUE_DECIMALS)}`),
    input('Policy', w.policy),
    input('Simulated powder', w.bench === 'devices' ? NONE : w.parameter_set),
    input('Bench', w.bench ? words(w.bench) : NONE),
    input('Seed', w.bench === 'devices' ? NONE : String(w.seed)),
    ...settings({ ...(w.asked ?? {}), ...(w.apparatus ? { apparatus: w.apparatus } : {}), ...(w.under ? { under: w.under } : {}) }),
  ],
}

export const KINDS: { [K in ComparedKind]: Kind<Reads[K]> } = { calibrations, trainings, policies, evaluations: evaluationKind, weighings }
