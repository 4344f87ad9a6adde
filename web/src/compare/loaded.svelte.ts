/** The things compared, read one by one and again when events say so. What cannot be read is named; the others are drawn. */
import { Problem } from '../api/problem'
import { live, SERIES_MS } from '../live.svelte'
import type { Kind } from './kinds'

/** So many are read at a time, each in up to two requests: a browser has six connections to a host, and others need some. */
const AT_A_TIME = 2

export class Loaded<T> {
  values = $state.raw<Record<string, T>>({})
  problems = $state.raw<Record<string, Problem>>({})
  #wanted: string[] = []
  #queue: string[] = []
  #busy = 0

  constructor(private readonly kind: Kind<T>) {}

  /** Reads those not yet read. */
  want(ids: string[]) {
    const fresh = ids.filter((id) => !this.#wanted.includes(id))
    this.#wanted = ids
    this.#ask(fresh)
  }

  /** Reads those again that are still changing; for use as an effect's body. */
  follow = (): (() => void) => {
    const changed = new Set<string>()
    return live.reloads(
      (event) => {
        const id = event.topic.split(':')[1] ?? ''
        if (this.#wanted.includes(id)) changed.add(id)
        return changed.size > 0
      },
      () => {
        // Without an event the service is back after a pause.
        this.#ask(changed.size > 0 ? [...changed] : this.#wanted.filter((id) => !this.values[id] || !this.kind.ended(this.values[id])))
        changed.clear()
      },
      SERIES_MS,
    )
  }

  #ask(ids: string[]) {
    this.#queue = [...new Set([...this.#queue, ...ids])].filter((id) => this.#wanted.includes(id))
    while (this.#busy < AT_A_TIME && this.#queue.length > 0) void this.#next(this.#queue.shift() as string)
  }

  async #next(id: string) {
    this.#busy++
    try {
      const value = await this.kind.read(id)
      this.values = { ...this.values, [id]: value }
      const { [id]: _, ...others } = this.problems
      this.problems = others
    } catch (error) {
      this.problems = { ...this.problems, [id]: Problem.of(error) }
    }
    this.#busy--
    this.#ask([])
  }
}
