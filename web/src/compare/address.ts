/** Values of the address, as text and back. What a person mistyped counts as absent. */

/** `12~80` as numbers in order. */
export function rangeOf(text: string): readonly [number, number] | undefined {
  const parts = text.split('~')
  const [a, b] = parts.map((part) => (part.trim() ? Number(part) : NaN))
  if (parts.length !== 2 || a === undefined || b === undefined || !Number.isFinite(a) || !Number.isFinite(b) || a === b) return undefined
  return a < b ? [a, b] : [b, a]
}

/** With as many digits as a pixel can show. */
export const rangeText = (low: number, high: number): string => [low, high].map((v) => Number(v.toPrecision(5))).join('~')

/** Parts between commas, each once. */
export const listOf = (text: string): string[] => [...new Set(text.split(',').map((part) => part.trim()).filter(Boolean))]

/** The choice that the address names, or the first. */
export const chosen = <T extends { key: string }>(choices: readonly T[], key: string): T => choices.find((choice) => choice.key === key) ?? (choices[0] as T)
