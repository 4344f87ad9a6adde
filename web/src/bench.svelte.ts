/** The bench as it stands now, for every view. */
import { bench } from './api/calls'
import type { BenchStatus } from './api/types'
import { live, ofWeighings } from './live.svelte'
import { Resource } from './resource.svelte'

/** Asked again this often while something moves, and while no events come: the last event comes just before the bench is free. */
const MOVING_MS = 2000

class BenchNow {
  #status = new Resource(bench)
  /** When the service was first found not to answer; what is shown of it is from before. */
  unanswered = $state.raw<Date>()

  constructor() {
    $effect.root(() => {
      $effect(() => live.reloads((event) => event.topic === 'bench' || ofWeighings(event), this.reload))
      $effect(() => {
        if (!this.value?.moving && live.open) return
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

  /** The one word for how it stands. */
  get stands(): 'moving' | 'latched' | 'held' | 'waiting' | 'ready' {
    const it = this.value
    if (it?.moving) return 'moving'
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
