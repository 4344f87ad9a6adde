/** Labels that callers write on weighings and jobs, to find them again, as a person types them: one per line, as `plate:A7`. */
import type { Say } from './language.svelte'

export type CallerLabels = Record<string, string>

/** Key of the caller's own id of one request. */
const CORRELATION_ID = 'correlation_id'
/** Bounds of the service. */
const COUNT_MAX = 32
const VALUE_MAX = 255
const BYTES_MAX = 4096
const KEY = /^[\w./-]{1,63}$/
const CONTROL = /\p{Cc}/u

/** As the service reads `key:value`: the value may hold further colons. */
function pairOf(line: string): [key: string, value: string] | undefined {
  const at = line.indexOf(':')
  return at < 0 ? undefined : [line.slice(0, at).trim(), line.slice(at + 1).trim()]
}
const linesOf = (text: string) => text.split('\n').map((line, k) => ({ line: k + 1, text: line.trim(), pair: pairOf(line) })).filter((it) => it.text)

/** What a person typed, without lines that {@link labelsFault} reports. */
export const labelsOf = (text: string): CallerLabels => Object.fromEntries(linesOf(text).flatMap(({ pair }) => (pair ? [pair] : [])))

/** As a person types them: for another request, so without the id of this one. */
export const labelsText = (labels: CallerLabels = {}): string =>
  Object.entries(labels).filter(([key]) => key !== CORRELATION_ID).map(([key, value]) => `${key}:${value}`).join('\n')

/** The first thing that is wrong with what a person typed. */
export function labelsFault(text: string, t: Say): string | undefined {
  const keys = new Set<string>()
  let bytes = 0
  for (const { line, pair } of linesOf(text)) {
    if (!pair) return t('Line {line}: must be a key and its value, as plate:A7', { line })
    const [key, value] = pair
    if (!KEY.test(key)) return t('Line {line}: the key must be 1 to 63 letters, digits, “-”, “_”, “.” or “/”', { line })
    if ([...value].length > VALUE_MAX || CONTROL.test(value)) return t('Line {line}: the value must be at most {most} characters, without tabs', { line, most: VALUE_MAX })
    if (keys.has(key)) return t('Line {line}: {key} has a value already', { line, key })
    keys.add(key)
    bytes += new TextEncoder().encode(key + value).length
  }
  if (keys.size > COUNT_MAX) return t('At most {most} labels, got {n}', { most: COUNT_MAX, n: keys.size })
  if (bytes > BYTES_MAX) return t('At most {most} bytes in all, got {n}', { most: BYTES_MAX, n: bytes })
  return undefined
}
