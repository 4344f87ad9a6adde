/** Values that this browser keeps, the same in all its tabs. */
class Kept<T> {
  #value = $state.raw() as T

  constructor(
    private readonly key: string,
    private readonly read: (stored: unknown) => T,
  ) {
    this.#value = this.#stored(localStorage.getItem(key))
    addEventListener('storage', (event) => {
      if (event.key === key) this.#value = this.#stored(event.newValue)
    })
  }

  get value(): T {
    return this.#value
  }
  /** Whether the browser kept it; where it keeps nothing, the value lasts as long as the tab. */
  set(value: T): boolean {
    this.#value = value
    try {
      localStorage.setItem(this.key, JSON.stringify(value))
      return true
    } catch {
      return false
    }
  }

  #stored(text: string | null): T {
    try {
      return this.read(text === null ? undefined : JSON.parse(text))
    } catch {
      return this.read(undefined)
    }
  }
}

export type { Kept }

/** One for each key, for as long as the page is open. */
const values = new Map<string, unknown>()

/** The value under this key; `read` makes one of whatever was stored, `undefined` if nothing was. */
export function kept<T>(key: string, read: (stored: unknown) => T): Kept<T> {
  const value = (values.get(key) as Kept<T> | undefined) ?? new Kept(key, read)
  values.set(key, value)
  return value
}
