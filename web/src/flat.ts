import { NONE } from './format'

/** A nested document as rows of dotted names and values. */
export function flat(value: unknown, name = ''): [name: string, value: string][] {
  if (Array.isArray(value) && value.every((v) => typeof v !== 'object')) return [[name, value.join(', ')]]
  if (typeof value === 'object' && value !== null) return Object.entries(value).flatMap(([key, inner]) => flat(inner, name ? `${name}.${key}` : key))
  return [[name, value === null || value === undefined ? NONE : String(value)]]
}
