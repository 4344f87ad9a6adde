/** The current state of the bench, for every view. */
import { bench } from './api/calls'
import type { BenchStatus, Event } from './api/types'
import { live, ofJobs, ofWeighings } from './live.svelte'
import { Resource } from './resource.svelte'

/** Reload interval while something moves, and while no events arrive: the last event arrives just before the bench is free. */
const MOVING_MS = 2000

/** Job events: the job may be a measurement that makes piles, which no bench event reports. */
const beginsOrGoesOn = (event: Event) => ofJobs(event) && (event.kind === 'state' || event.kind === 'progress')

class BenchNow {
  #status = new Resource(bench)
  /** When the service was first found not to respond; the values shown are older than that. */
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

  /** Identifies the one thing that moves: a dose or a pile. */
  get moves(): string | undefined {
    const { moving, piling } = this.value ?? {}
    return moving ?? (piling ? `${piling.job} ${piling.pile}` : undefined)
  }

  /** Its state in one word. */
  get stands(): 'moving' | 'latched' | 'held' | 'waiting' | 'ready' {
    const it = this.value
    if (this.moves) return 'moving'
    if (it?.latch) return 'latched'
    if (it?.held) return 'held'
    return it?.waiting?.length ? 'waiting' : 'ready'
  }
}

export const benchNow = new BenchNow()

/** "2 doses are waiting". */
export function waitingText({ waiting }: BenchStatus): string {
  const n = waiting?.length ?? 0
  return n === 1 ? 'One dose is waiting' : `${n} doses are waiting`
}
