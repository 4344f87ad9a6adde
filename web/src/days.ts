/** Days of the reader's, as an address has them. */

/** The day so many days ago, as 2026-11-24. */
export function dayAgo(days: number): string {
  const at = new Date()
  at.setDate(at.getDate() - days)
  // Swedish writes days as an address does.
  return at.toLocaleDateString('sv')
}

/** The beginning of a day, so many days later, as an instant. */
export function midnight(day: string | undefined, days: number): string | undefined {
  const at = new Date(`${day}T00:00`)
  at.setDate(at.getDate() + days)
  return Number.isNaN(at.getTime()) ? undefined : at.toISOString()
}
