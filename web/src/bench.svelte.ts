/** The current state of the bench, for every view. */
import { bench } from './api/calls'
import type { BenchStatus, Event, Waiting } from './api/types'
import { num } from './format'
import { t } from './language.svelte'
import { live, ofJobs, ofWeighings } from './live.svelte'
import { powderName } from './names.svelte'
import { Resource } from './resource.svelte'
import { TRUE_DECIMALS } from './weighing'

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

/** "2 doses are waiting." */
export function waitingText({ waiting }: BenchStatus): string {
  return t('{n, plural, one {One dose is waiting.} other {{n} doses are waiting.}}', { n: waiting?.length ?? 0 })
}

/** What to do for a dose that waits for its vial. */
export function insertText(vial: string | null | undefined): string {
  return vial ? t('Insert vial {vial}, then confirm', { vial }) : t('Insert an empty vial, then confirm')
}

/** What a waiting dose is of, and its vial. */
export function doseText({ target_mg, powder, vial }: Waiting): string {
  const named = { mass: num(target_mg, TRUE_DECIMALS), powder: powderName(powder), vial: vial ?? '' }
  return t(vial ? '{mass} mg of {powder}, vial {vial}' : '{mass} mg of {powder}', named)
}
