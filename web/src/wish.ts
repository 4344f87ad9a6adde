/**
 * The keys of doses that were asked for.
 *
 * A key belongs to what was asked until an answer proves that it was taken on or surely refused: sent again with the same
 * contents after a lost answer it pours nothing new. Kept by the tab, so that a reload does not lose it.
 */

const PLACE = 'flip-wishes'
/** The oldest are forgotten beyond so many. */
const MOST = 20

interface Wish {
  contents: string
  key: string
  /** When it was asked for first. */
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

/** crypto.randomUUID needs TLS or loopback, this does not. */
function newKey(): string {
  return [...crypto.getRandomValues(new Uint8Array(16))].map((b) => b.toString(16).padStart(2, '0')).join('')
}

/** The key for these contents: the one they were sent with before, if it is not known what became of them. */
export function keyFor(contents: string): string {
  const wishes = read()
  const known = wishes.find((wish) => wish.contents === contents)
  if (known) return known.key
  const wish = { contents, key: newKey(), at: new Date().toISOString() }
  write([...wishes, wish])
  return wish.key
}

/** It is known what became of them: asked for again they are another wish. */
export function settled(contents: string): void {
  write(read().filter((wish) => wish.contents !== contents))
}

/** What was asked for and may or may not have been taken on, oldest first. */
export const unsettled = (): Wish[] => read()
