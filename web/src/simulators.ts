/** Versions of the simulator side by side. The description of a version may grow: parts that the page does not know are shown as they are. */
import type { Cause, Report, SimulatorVersion } from './api/types'
import { causeName, columnName, interval, levelName, lower, parameterName, percent, withUnit } from './discovery'
import { NONE, num, shortId, significant, signed, words } from './format'

/** The simulator that no investigation extended. */
export const BASE = 'base'

type Known = Pick<Report, 'sentence' | 'unexplained' | 'gain'> & { causes: Cause[]; verified: boolean }

/** The base, or a version that extends it. */
export interface Simulator {
  id: string
  /** Absent for the base. */
  version?: SimulatorVersion
  body: Partial<Known>
}

const isObject = (value: unknown): value is Record<string, unknown> => typeof value === 'object' && value !== null && !Array.isArray(value)

/** `name` is how versions that extend it refer to it. */
export const baseSimulator = (name: string): Simulator => ({ id: BASE, body: { sentence: `${name}, as calibrated: one angle for each powder, regardless of conditions.` } })

export function simulatorOf(version: SimulatorVersion): Simulator {
  const body: Record<string, unknown> = isObject(version.body) ? version.body : {}
  const { sentence, causes, unexplained, gain, verified } = body
  const known: Partial<Known> = {}
  if (typeof sentence === 'string') known.sentence = sentence
  if (Array.isArray(causes)) known.causes = causes.filter((cause) => isObject(cause) && typeof cause.mechanism === 'string') as unknown as Cause[]
  if (isObject(unexplained)) known.unexplained = unexplained as unknown as Known['unexplained']
  if (isObject(gain) && isObject(gain.held_out)) known.gain = gain as unknown as Known['gain']
  if (typeof verified === 'boolean') known.verified = verified
  return { id: version.id, version, body: known }
}

/** A condition that a version acts through: numbers within a range, or names. */
export interface Through {
  name: string
  lower?: number
  upper?: number
  names?: string[]
}

/** The conditions under which a version can be asked, as seen in its campaign. */
export function throughOf({ version }: Simulator): Through[] {
  const extensions = isObject(version?.body) && Array.isArray(version.body.extensions) ? (version.body.extensions as unknown[]) : []
  const found = new Map<string, Through>()
  for (const extension of extensions) {
    const through = isObject(extension) && Array.isArray(extension.through) ? (extension.through as unknown[]) : []
    for (const it of through) {
      if (!isObject(it) || typeof it.name !== 'string' || found.has(it.name)) continue
      const quantiles = Array.isArray(it.quantiles) ? it.quantiles.filter((q) => typeof q === 'number') : []
      const range = quantiles.length > 0 ? { lower: quantiles[0], upper: quantiles.at(-1) } : { names: Object.keys(isObject(it.shares) ? it.shares : {}) }
      found.set(it.name, { name: it.name, ...range })
    }
  }
  return [...found.values()]
}

/** Shown in lines of their own, or part of the causes. */
const KNOWN = ['sentence', 'causes', 'unexplained', 'gain', 'verified', 'extensions', 'powders']

/** Anything as one line of text. */
export function plain(value: unknown): string {
  if (value === null || value === undefined) return NONE
  if (typeof value === 'number') return significant(value)
  if (typeof value === 'boolean') return value ? 'yes' : 'no'
  if (Array.isArray(value)) return value.length > 0 ? value.map(plain).join('; ') : NONE
  if (isObject(value)) return Object.entries(value).map(([key, it]) => `${words(key)}: ${plain(it)}`).join(', ') || NONE
  return String(value)
}

/** The name of a simulator in drop-down lists. */
export function simulatorName({ id, version, body }: Simulator): string {
  if (!version) return 'Base simulator'
  if (version.label?.name) return version.label.name
  const what = (body.causes ?? []).map((cause, k) => (k === 0 ? causeName(cause.mechanism) : lower(causeName(cause.mechanism)))).join(' and ')
  const { covariate } = body.unexplained ?? {}
  const law = body.unexplained ? causeName(covariate ? `unknown: ${covariate}` : 'unrecorded') : ''
  return [what || law, shortId(id)].filter(Boolean).join(', ')
}

/** Reduction of the error on left-out days, with its interval; sorted by the number alone. */
export function gainOf({ body }: Simulator): { value: number; text: string } | undefined {
  const it = body.gain?.held_out
  return it && { value: it.rmse_before - it.rmse_after, text: `${signed(it.rmse_before - it.rmse_after)} ${interval(it.ci95, 2)}` }
}

export const yesNo = (value: boolean | undefined) => (value === undefined ? NONE : value ? 'yes' : 'not yet')

export interface Line {
  what: string
  cells: [string, string]
}

type Gain = NonNullable<Known['gain']>

/** Everything known about two simulators, one line per item. The base is judged on the other's days. */
export function compared(a: Simulator, b: Simulator): Line[] {
  const sides = [a, b] as const
  const others = [b, a] as const
  const line = (what: string, cell: (side: Simulator, other: Simulator) => string): Line => ({ what, cells: [cell(sides[0], others[0]), cell(sides[1], others[1])] })
  /** A score from the gain: after the extension, or, for the base, before it on the other's days. */
  const score = (after: (gain: Gain) => string, before: (gain: Gain) => string) => (side: Simulator, other: Simulator) => {
    if (side.version) return side.body.gain ? after(side.body.gain) : NONE
    return other.body.gain ? before(other.body.gain) : NONE
  }
  const own = (cell: (gain: Gain) => string) => (side: Simulator) => (side.body.gain ? cell(side.body.gain) : NONE)
  const mechanisms = [...new Set(sides.flatMap((side) => (side.body.causes ?? []).map((cause) => cause.mechanism)))]
  const causeOf = (side: Simulator, mechanism: string) => side.body.causes?.find((cause) => cause.mechanism === mechanism)
  const lines = [line('Extends', (side) => side.version?.base ?? 'nothing')]
  for (const mechanism of mechanisms) {
    const name = causeName(mechanism)
    lines.push(line(name, (side) => {
      const cause = causeOf(side, mechanism)
      return cause ? `${percent(cause.inclusion_probability)} % probable, level ${cause.confidence_level} of 3` : NONE
    }))
    const parameters = [...new Set(sides.flatMap((side) => (causeOf(side, mechanism)?.parameters ?? []).map((p) => p.name)))]
    for (const parameter of parameters) {
      lines.push(line(`${name}: ${lower(parameterName(parameter))} [95 %]`, (side) => {
        const it = causeOf(side, mechanism)?.parameters?.find((p) => p.name === parameter)
        return it ? `${withUnit(significant(it.value, 3), it.unit)} [${significant(it.ci95[0], 3)}, ${significant(it.ci95[1], 3)}]` : NONE
      }))
    }
  }
  if (sides.some((side) => side.body.unexplained)) {
    lines.push(line('Law of an unknown cause', ({ body }) => (body.unexplained ? `${body.unexplained.covariate ? `${columnName(body.unexplained.covariate)}: ` : ''}${body.unexplained.law}` : NONE)))
  }
  lines.push(
    line('Confirmed by simulations', (side) => (side.version ? yesNo(side.body.verified) : NONE)),
    line('RMS error on days left out', score((g) => withUnit(num(g.held_out.rmse_after), g.held_out.unit), (g) => withUnit(num(g.held_out.rmse_before), g.held_out.unit))),
    line('The base on the same days', own((g) => withUnit(num(g.held_out.rmse_before), g.held_out.unit))),
    line('Reduction [95 %]', (side) => (side.version ? (gainOf(side)?.text ?? NONE) : NONE)),
    line('Runs left out', score((g) => String(g.held_out.n), (g) => String(g.held_out.n))),
    line('Log score, nats per run (higher is better)', score((g) => num(g.log_score?.after), (g) => num(g.log_score?.before))),
    line('Runs within their 90 % interval, % (ideal: 90)', score((g) => (g.coverage90 ? percent(g.coverage90.after) : NONE), (g) => (g.coverage90 ? percent(g.coverage90.before) : NONE))),
  )
  if (sides.some((side) => side.body.gain?.weighing_error_mg)) {
    lines.push(
      line('Mean weighing error, mg', score((g) => num(g.weighing_error_mg?.after), (g) => num(g.weighing_error_mg?.before))),
      line('The same, trained equally long on an extension with no effect, mg', own((g) => num(g.weighing_error_mg?.sham))),
    )
  }
  const rest = [...new Set(sides.flatMap((side) => Object.keys(isObject(side.version?.body) ? side.version.body : {})))].filter((key) => !KNOWN.includes(key))
  for (const key of rest) {
    lines.push(line(words(key), (side) => plain(isObject(side.version?.body) ? side.version.body[key] : undefined)))
  }
  return lines
}

/** The meaning of each level, for the text under the table. */
export const levels = [1, 2, 3].map((level) => `${level}: ${levelName(level)}`).join('; ')

/** A row of a campaign with the predictions of both simulators. */
export interface Prediction {
  row: number
  powder: string
  at: number | null
  measured: number | null
  angles: [number | null, number | null]
}

/** Conditions over which two simulators can be plotted: those of findings first. */
export function conditionsOf(reports: Report[]): string[] {
  const found = reports.flatMap((report) => [...report.findings.map((finding) => finding.covariate ?? ''), report.unexplained?.covariate ?? '']).flatMap((name) => name.split(' and '))
  const drawn = reports.flatMap((report) => report.curves.map((curve) => curve.covariate))
  return [...new Set([...found, ...drawn])].filter((name) => drawn.includes(name))
}

/** Names of the values of a condition, over all campaigns. */
export const namesOf = (reports: Report[], condition: string) =>
  [...new Set(reports.flatMap((report) => report.curves.find((curve) => curve.covariate === condition)?.levels ?? []))]

/** Predictions of two simulators for the rows of their campaigns. A version has no stored predictions for another version's campaign. */
export function predictionsOf(sides: readonly [Simulator, Simulator], reports: Map<string, Report>, condition: string): Prediction[] {
  const campaigns = [...new Set(sides.flatMap((side) => side.version?.investigation ?? []))]
  const names = namesOf([...reports.values()], condition)
  return campaigns.flatMap((campaign) => {
    const report = reports.get(campaign)
    const curve = report?.curves.find((it) => it.covariate === condition)
    if (!report || !curve) return []
    return report.rows.map((row, k) => {
      const at = curve.at[k] ?? null
      const level = at === null ? undefined : curve.levels[at]
      const angle = (side: Simulator) => {
        if (!side.version) return row.before_deg ?? null
        return side.version.investigation === campaign ? (row.after_deg ?? null) : null
      }
      return { row: row.row, powder: row.powder, at: level === undefined ? at : names.indexOf(level), measured: row.measured_deg ?? null, angles: [angle(sides[0]), angle(sides[1])] as [number | null, number | null] }
    })
  })
}
