/** The bench as it stands now, for every view. */
import { bench } from './api/calls'
import type { BenchStatus, Event } from './api/types'
import { live, ofJobs, ofWeighings } from './live.svelte'
import { Resource } from './resource.svelte'

/** Asked again this often while something moves, and while no events come: the last event comes just before the bench is free. */
const MOVING_MS = 2000

/** Of a job: it may be a measurement that makes piles, which no event of the bench tells. */
const beginsOrGoesOn = (event: Event) => ofJobs(event) && (event.kind === 'state' || event.kind === 'progress')

class BenchNow {
  #status = new Resource(bench)
  /** When the service was first found not to answer; what is shown of it is from before. */
  unanswered = $state.raw<Date>()

  constructor() {
    $effect.root(() => {
      $effect(() => live.reloads((event) => event.topic === 'bench' || ofWeighings(event) || beginsOrGoesOn(event), this.reload))
      $effect(() => {
        if (!this.moves && live.open) return
        const timer = setInterval(() => document.visibilityState === 'visible' && this.reload(), MOVING_MS)
        return () => clearInterval(timer)
      })
      $effect(() => {
        const lost = this.#status.problem?.status === 0
        if (!lost) this.unanswered = undefined
        else this.unanswered ??= new Date()
      })
    })
  }

  get value() {
    return this.#status.value
  }
  get problem() {
    return this.#status.problem
  }
  reload = () => this.#status.reload()

  /** The one thing that moves, by a name of its own: a dose, or a pile. */
  get moves(): string | undefined {
    const { moving, piling } = this.value ?? {}
    return moving ?? (piling ? `${piling.job} ${piling.pile}` : undefined)
  }

  /** The one word for how it stands. */
  get stands(): 'moving' | 'latched' | 'held' | 'waiting' | 'ready' {
    const it = this.value
    if (this.moves) return 'moving'
    if (it?.latch) return 'latched'
    if (it?.held) return 'held'
    return it?.waiting?.length ? 'waiting' : 'ready'
  }
}

export const benchNow = new BenchNow()

/** "2 doses wait". */
export function waitingText({ waiting }: BenchStatus): string {
  const n = waiting?.length ?? 0
  return n === 1 ? 'One dose waits' : `${n} doses wait`
}
