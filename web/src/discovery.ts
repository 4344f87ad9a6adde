/** The words of an investigation: columns, causes, verdicts. */
import type { Curve, Finding, Report } from './api/types'
import { num, words } from './format'
import names from './names.json'

/** Generated from the service's own names, which its reports use: `names.rs`. */
const UNITS = names.units as [string, string][]
const COLUMNS: Record<string, string> = names.columns
const CAUSES: Record<string, string> = names.causes
const FORMS: Record<string, string> = names.forms
const PARAMETERS: Record<string, string> = names.parameters

/** Label and unit of a column. */
export function columnOf(name: string): { label: string; unit: string } {
  const [ending, unit] = UNITS.find(([e]) => name.length > e.length && name.endsWith(e)) ?? ['', '']
  return { label: COLUMNS[name] ?? words(ending ? name.slice(0, -ending.length) : name), unit }
}
/** `Relative humidity (%)`. */
export function columnName(name: string): string {
  const { label, unit } = columnOf(name)
  return unit ? `${label} (${unit})` : label
}
export const lower = (phrase: string) => phrase.charAt(0).toLowerCase() + phrase.slice(1)

export function causeName(name: string): string {
  const covariate = name.startsWith('unknown: ') ? name.slice(9) : ''
  return covariate ? `Unknown cause, with ${lower(columnOf(covariate).label)}` : (CAUSES[name] ?? words(name))
}
/** A fitted number in words. */
export const parameterName = (name: string) => PARAMETERS[name] ?? words(name)
export const levelName = (level: number) => names.levels[level - 1] ?? ''

/** The condition a finding depends on, and its range. */
export function findingName({ covariate, span }: Finding): string {
  const label = covariate ? columnOf(covariate).label : 'Nothing recorded'
  const repeated = lower(label)
  return `${label}, ${span.endsWith(repeated) ? span.slice(0, -repeated.length).trimEnd() : span}`
}

/** `a`, `a and b`, `a, b and c`. */
export const listed = (items: string[]) => (items.length < 2 ? (items[0] ?? '') : `${items.slice(0, -1).join(', ')} and ${items.at(-1)}`)

/** `[1.6, 3.1]`. */
export const interval = (ci95: number[], decimals: number) => `[${num(ci95[0], decimals)}, ${num(ci95[1], decimals)}]`
export const chance = (p: number) => num(p, p >= 0.1 ? 2 : p >= 0.001 ? 3 : 4)
/** A share in percent; a value close to none or all is not rounded to it. */
export const percent = (share: number) => (share > 0 && share < 0.005 ? '< 1' : share < 1 && share > 0.995 ? '> 99' : num(100 * share, 0))
/** Degree signs follow the number directly, other units after a space. */
export const withUnit = (number: string, unit: string) => (unit === 'deg' || unit === '°' ? `${number}°` : unit && unit !== '1' ? `${number} ${unit}` : number)

/** What a verdict does and does not mean. */
export function meaning(report: Report): string {
  const readings = report.traces != null && report.traces.verdict !== 'no_discrepancy'
  const flow = (report.beside ?? []).some((it) => it.channel === 'flow_time' && it.verdict !== 'no_discrepancy')
  const creeps = report.causes.some((cause) => cause.mechanism === 'creep')
  const angles = !(readings || flow || creeps) || report.findings.some((finding) => finding.channel === 'repose')
  const what = [angles && 'measured angles', flow && 'flow times', readings && 'balance readings'].filter((it) => typeof it === 'string')
  if (creeps && what.length === 0) return 'Regardless of the measurements, simulated heaps keep moving: the fault is in how they are computed. These data show nothing else.'
  const depart = `The ${listed(what)} deviate from the simulation`
  switch (report.verdict) {
    case 'no_discrepancy':
      if (report.unjudged) return 'These angles can show neither that the simulation is wrong nor that it is right.'
      return 'These data do not show that the simulation is wrong. That does not prove it right: see below which effects this campaign would have found, and which it cannot show.'
    case 'cause':
      return `${depart}, and a cause in the catalogue explains how. A good explanation is not proof; only an experiment that changes the cause is.`
    case 'ambiguous':
      return `${depart}, but this campaign cannot distinguish between ${listed(report.ambiguous_between.map((name) => lower(causeName(name)))) || 'several causes'}.${report.suggested_experiment ? ' The experiment below would be the most informative.' : ''}`
    case 'hint':
      return 'Evidence this strong is rare by chance, and it points to one cause. But the effect cannot be distinguished from zero, or it does not improve the prediction of left-out days. Do not act on it before the experiment below.'
    case 'unexplained': {
      const law = report.unexplained
      const on = law?.covariate ? `It depends on ${lower(columnOf(law.covariate).label)}` : 'No recorded condition explains it'
      return `${depart}, and no cause in the catalogue explains how.${law ? ` ${on}. Its law (${FORMS[law.form_class] ?? law.form_class}): ${law.law.replace(/\.$/, '')}.` : ''}`
    }
  }
}

/** Powders in file order: their position determines how they are drawn. */
export const powdersOf = (report: Report) => [...new Set(report.rows.map((row) => row.powder))]

/** Curves in order of interest: findings, then unknown causes with the most probable first, then all others. */
export function curvesOf(report: Report): Curve[] {
  const named = [
    ...report.findings.map((finding) => finding.covariate ?? ''),
    report.unexplained?.covariate ?? '',
    ...report.evidence.filter((e) => e.cause.startsWith('unknown: ')).map((e) => e.cause.slice(9)),
  ]
  const place = (curve: Curve) => (named.includes(curve.covariate) ? named.indexOf(curve.covariate) : named.length)
  return report.curves.filter((curve) => curve.at.some((at) => at !== null)).sort((a, b) => place(a) - place(b))
}
