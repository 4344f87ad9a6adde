/** Server-sent events, one stream for all tabs of this browser. A hidden tab receives none and reloads everything when it is shown. */
import type { Event } from './api/types'
import { BEAT_MS, type Told } from './events/hub'
import { link } from './events/link'
import { settings } from './settings.svelte'

type Listener = (event: Event) => void

/** Bursts of events reload a view's data at most this often. */
const SETTLE_MS = 400
/** A growing series of thousands of trials or episodes is reloaded at most this often. */
export const SERIES_MS = 2500

class Live {
  /** Whether events arrive. */
  open = $state(false)
  #listeners = new Set<Listener>()
  #again = new Set<() => void>()
  #broken = false
  #say = link((told) => this.#hear(told))

  constructor() {
    this.restart()
    setInterval(() => document.visibilityState === 'visible' && this.restart(), BEAT_MS)
    document.addEventListener('visibilitychange', () => {
      this.restart()
      if (document.visibilityState === 'visible') this.#ask()
    })
    addEventListener('pagehide', () => this.#say({ kind: 'gone' }))
    addEventListener('pageshow', () => this.restart())
  }

  /** Calls `listener` for every event until the returned function is called. */
  on(listener: Listener): () => void {
    this.#listeners.add(listener)
    return () => this.#listeners.delete(listener)
  }

  /** Calls `reload` soon after events that `concerns` selects, once for many events, and when the service is back. For use as an effect's body. */
  reloads(concerns: (event: Event) => boolean, reload: () => unknown, settle = SETTLE_MS): () => void {
    let timer: ReturnType<typeof setTimeout> | undefined
    const soon = () => {
      timer ??= setTimeout(() => {
        timer = undefined
        // A hidden tab reloads what it missed when it is shown.
        if (document.visibilityState === 'visible') void reload()
      }, settle)
    }
    const off = this.on((event) => {
      // A name may be on any view.
      if (concerns(event) || event.topic === 'label') soon()
    })
    this.#again.add(soon)
    return () => {
      off()
      this.#again.delete(soon)
      clearTimeout(timer)
    }
  }

  /** Announces this tab again, for instance with another token. */
  restart() {
    this.#say({ kind: 'here', token: settings.token, visible: document.visibilityState === 'visible' })
  }

  #ask() {
    this.#again.forEach((soon) => soon())
  }

  #hear(told: Told) {
    if (told.kind === 'event') return this.#listeners.forEach((listener) => listener(told.event))
    if (told.kind === 'again') return this.#ask()
    if (told.kind === 'heard') return
    this.open = told.open
    // Reload what failed while the service was away. That it is away is also noticed by a request.
    if (this.#broken || !told.open) this.#ask()
    this.#broken = !told.open
  }
}

export const live = new Live()

/** Events of jobs. */
export const ofJobs = (event: Event) => event.topic.startsWith('job:')
/** Events of weighings. */
export const ofWeighings = (event: Event) => event.topic.startsWith('weighing:')
/** Something started or ended: lists and summaries change. Growing curves have other events. */
export const ofStates = (event: Event) => event.kind === 'state'
