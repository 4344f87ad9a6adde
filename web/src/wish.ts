/**
 * The idempotency keys of requested doses.
 *
 * A request keeps its key until a response proves that it was accepted or definitely refused: resent with the same
 * contents after a lost response, it pours nothing new. The tab keeps the keys, so that a reload does not lose them.
 */

const PLACE = 'flip-wishes'
/** Beyond this number the oldest are forgotten. */
const MOST = 20

interface Wish {
  contents: string
  key: string
  /** When it was first requested. */
  at: string
}

function read(): Wish[] {
  try {
    const kept: unknown = JSON.parse(sessionStorage.getItem(PLACE) ?? '[]')
    return Array.isArray(kept) ? (kept as Wish[]) : []
  } catch {
    return []
  }
}
const write = (wishes: Wish[]) => sessionStorage.setItem(PLACE, JSON.stringify(wishes.slice(-MOST)))

/** crypto.randomUUID needs TLS or loopback; this does not. */
export function newKey(): string {
  return [...crypto.getRandomValues(new Uint8Array(16))].map((b) => b.toString(16).padStart(2, '0')).join('')
}

/** The key for these contents: the one they were sent with before, if the outcome of that request is not known. */
export function keyFor(contents: string): string {
  const wishes = read()
  const known = wishes.find((wish) => wish.contents === contents)
  if (known) return known.key
  const wish = { contents, key: newKey(), at: new Date().toISOString() }
  write([...wishes, wish])
  return wish.key
}

/** The outcome is known: requested again, the same contents are a new request. */
export function settled(contents: string): void {
  write(read().filter((wish) => wish.contents !== contents))
}

/** Requests that may or may not have been accepted, oldest first. */
export const unsettled = (): Wish[] => read()
