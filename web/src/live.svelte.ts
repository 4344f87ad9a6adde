/** One stream of server-sent events for the whole page, resumed after a break at the last event seen. */
import type { Event } from './api/types'
import { settings } from './settings.svelte'

type Listener = (event: Event) => void

const RETRY_MS = 2000
/** Bursts of events ask for a view's data at most this often. */
const SETTLE_MS = 400
/** A growing series of thousands of trials or episodes is asked for at most this often. */
export const SERIES_MS = 2500

class Live {
  /** Whether events arrive. */
  open = $state(false)
  #listeners = new Set<Listener>()
  #reopened = new Set<() => void>()
  #broken = false
  #last = ''
  #abort = new AbortController()

  constructor() {
    void this.#run()
  }

  /** Calls `listener` for every event until the returned function is called. */
  on(listener: Listener): () => void {
    this.#listeners.add(listener)
    return () => this.#listeners.delete(listener)
  }

  /** Calls `reload` soon after events that `concerns` picks, many events at once, and when the service is back. For use as an effect's body. */
  reloads(concerns: (event: Event) => boolean, reload: () => unknown, settle = SETTLE_MS): () => void {
    let timer: ReturnType<typeof setTimeout> | undefined
    const soon = () => {
      timer ??= setTimeout(() => {
        timer = undefined
        void reload()
      }, settle)
    }
    const off = this.on((event) => {
      if (concerns(event)) soon()
    })
    this.#reopened.add(soon)
    return () => {
      off()
      this.#reopened.delete(soon)
      clearTimeout(timer)
    }
  }

  /** Connects anew, for instance with another token. */
  restart() {
    this.#abort.abort()
    this.#abort = new AbortController()
  }

  async #run(): Promise<never> {
    for (;;) {
      const { signal } = this.#abort
      try {
        await this.#read(signal)
      } catch {
        // The stream broke or the service is away: the loop tries again, and `open` says so.
      }
      this.open = false
      this.#broken = true
      if (!signal.aborted) await new Promise((resolve) => setTimeout(resolve, RETRY_MS))
    }
  }

  // EventSource cannot send an Authorization header, hence fetch.
  async #read(signal: AbortSignal): Promise<void> {
    const headers: Record<string, string> = { accept: 'text/event-stream' }
    if (this.#last) headers['last-event-id'] = this.#last
    if (settings.token) headers.authorization = `Bearer ${settings.token}`
    const response = await fetch('/v1/events', { headers, signal })
    if (!response.ok || !response.body) return
    this.open = true
    // What failed while the service was away is asked for again.
    if (this.#broken) this.#reopened.forEach((soon) => soon())
    const reader = response.body.pipeThrough(new TextDecoderStream()).getReader()
    let text = ''
    for (;;) {
      const { done, value } = await reader.read()
      if (done) return
      text += value
      const messages = text.split(/\r?\n\r?\n/)
      text = messages.pop() ?? ''
      messages.forEach((message) => this.#take(message))
    }
  }

  #take(message: string) {
    let data = ''
    for (const line of message.split(/\r?\n/)) {
      if (line.startsWith('data:')) data += line.slice(5).trimStart()
      else if (line.startsWith('id:')) this.#last = line.slice(3).trim()
    }
    if (!data) return
    const event = JSON.parse(data) as Event
    this.#listeners.forEach((listener) => listener(event))
  }
}

export const live = new Live()

/** Events of jobs. */
export const ofJobs = (event: Event) => event.topic.startsWith('job:')
/** Events of weighings. */
export const ofWeighings = (event: Event) => event.topic.startsWith('weighing:')
/** Something began or ended: lists and summaries change, curves grow elsewhere. */
export const ofStates = (event: Event) => event.kind === 'state'
