/** Values from the service, with any problem and a way to reload. */
import { Problem } from './api/problem'
import { placeIn } from './place'

/** One document. */
export class Resource<T> {
  value = $state.raw<T | undefined>()
  problem = $state.raw<Problem | undefined>()
  #asked = 0

  constructor(private readonly fetch: () => Promise<T>) {
    void this.reload()
  }

  /** Reloads; the old value stays until the new one arrives. A late response to an earlier request is dropped. */
  reload = async (): Promise<void> => {
    const question = ++this.#asked
    try {
      const value = await this.fetch()
      if (question !== this.#asked) return
      this.value = value
      this.problem = undefined
    } catch (error) {
      if (question === this.#asked) this.problem = Problem.of(error)
    }
  }
}

export interface Page<T> {
  items: T[]
  next?: string | null
  /** How many there are in all, where the list says so. */
  total?: number
}

/** Which page of a list is requested. */
export interface Query {
  limit?: number
  after?: string
}

const PAGE = 50
const PAGE_MAX = 200

/** A list read page by page. */
export class Pages<T> {
  items = $state.raw<T[] | undefined>()
  next = $state.raw<string | null | undefined>()
  total = $state.raw<number | undefined>()
  problem = $state.raw<Problem | undefined>()
  #asked = 0

  /** With the name of a list, who comes back to it finds as many as were there. */
  constructor(
    private readonly fetch: (query: Query) => Promise<Page<T>>,
    private readonly name?: string,
  ) {
    void this.#ask([], undefined, Math.max(PAGE, (name && placeIn(name).count) || 0))
  }

  /** Reloads as many as are shown, so that the reader keeps the place. */
  reload = () => this.#ask([], undefined, Math.max(PAGE, this.items?.length ?? 0))

  /** Begins again with the first page, as after another question. */
  restart = () => this.#ask([], undefined, PAGE)

  /** Appends the next page. */
  more = () => this.#ask(this.items ?? [], this.next ?? undefined, PAGE_MAX)

  /** Shows these items, and so many more after them. */
  async #ask(items: T[], after: string | undefined, count: number): Promise<void> {
    const question = ++this.#asked
    try {
      const most = items.length + count
      let page: Page<T>
      do {
        page = await this.fetch({ limit: Math.min(PAGE_MAX, most - items.length), after })
        if (question !== this.#asked) return
        items = [...items, ...page.items]
        after = page.next ?? undefined
      } while (after && items.length < most)
      this.items = items
      if (this.name) placeIn(this.name).count = items.length
      this.next = page.next
      this.total = page.total
      this.problem = undefined
    } catch (error) {
      if (question !== this.#asked) return
      this.problem = Problem.of(error)
      // To what is not understood, the rows of an earlier question are no answer.
      if (this.problem.status === 400 && !after) {
        this.items = []
        this.next = this.total = undefined
      }
    }
  }
}

/** Maximum number of items on a page of a series (trials, episodes). */
export const SERIES = 5000

/** Every item of a list known to be of modest length, read in pages of `limit`. */
export async function all<T>(fetch: (query: Query) => Promise<Page<T>>, limit = PAGE_MAX, most = 40_000): Promise<T[]> {
  const items: T[] = []
  let after: string | undefined
  do {
    const page = await fetch({ limit, after })
    items.push(...page.items)
    after = page.next ?? undefined
  } while (after && items.length < most)
  return items
}
