/** The words of an investigation: columns, causes, numbers. */
import { num, words } from './format'
import names from './names.json'

/** Generated from the service's own names, which its reports use: `names.rs`. */
const UNITS = names.units as [string, string][]
const COLUMNS: Record<string, string> = names.columns
const CAUSES: Record<string, string> = names.causes
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

/** `a`, `a and b`, `a, b and c`. */
export const listed = (items: string[]) => (items.length < 2 ? (items[0] ?? '') : `${items.slice(0, -1).join(', ')} and ${items.at(-1)}`)

/** `[1.6, 3.1]`. */
export const interval = (ci95: number[], decimals: number) => `[${num(ci95[0], decimals)}, ${num(ci95[1], decimals)}]`
export const chance = (p: number) => num(p, p >= 0.1 ? 2 : p >= 0.001 ? 3 : 4)
/** A share in percent; a value close to none or all is not rounded to it. */
export const percent = (share: number) => (share > 0 && share < 0.005 ? '< 1' : share < 1 && share > 0.995 ? '> 99' : num(100 * share, 0))
/** Degree signs follow the number directly, other units after a space. */
export const withUnit = (number: string, unit: string) => (unit === 'deg' || unit === '°' ? `${number}°` : unit && unit !== '1' ? `${number} ${unit}` : number)
