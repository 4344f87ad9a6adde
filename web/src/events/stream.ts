/** One stream of server-sent events, resumed after a break at the last event seen. */
import type { Event } from '../api/types'

const RETRY_MS = 2000
/** The service sends a comment every 15 s; a stream silent for this long is broken. */
const SILENT_MS = 40_000

export interface Follower {
  /** Whether events arrive. */
  open(open: boolean): void
  event(event: Event): void
}

export class Stream {
  #closed = new AbortController()
  #last = ''

  constructor(
    private readonly token: string,
    private readonly follower: Follower,
  ) {
    void this.#run()
  }

  close() {
    this.#closed.abort()
  }

  async #run(): Promise<void> {
    const { signal } = this.#closed
    while (!signal.aborted) {
      try {
        await this.#read()
      } catch {
        // The stream broke or the service is away: retry, and tell the follower.
      }
      if (signal.aborted) return
      this.follower.open(false)
      await new Promise((resolve) => setTimeout(resolve, RETRY_MS))
    }
  }

  // EventSource cannot send an Authorization header, hence fetch.
  async #read(): Promise<void> {
    const headers: Record<string, string> = { accept: 'text/event-stream' }
    if (this.#last) headers['last-event-id'] = this.#last
    if (this.token) headers.authorization = `Bearer ${this.token}`
    const silent = new AbortController()
    const quiet = () => setTimeout(() => silent.abort(), SILENT_MS)
    let timer = quiet()
    try {
      const response = await fetch('/v1/events', { headers, cache: 'no-store', signal: AbortSignal.any([this.#closed.signal, silent.signal]) })
      if (!response.ok || !response.body) return
      this.follower.open(true)
      const reader = response.body.pipeThrough(new TextDecoderStream()).getReader()
      let text = ''
      for (;;) {
        const { done, value } = await reader.read()
        if (done) return
        clearTimeout(timer)
        timer = quiet()
        text += value
        const messages = text.split(/\r?\n\r?\n/)
        text = messages.pop() ?? ''
        messages.forEach((message) => this.#take(message))
      }
    } finally {
      clearTimeout(timer)
      silent.abort()
    }
  }

  #take(message: string) {
    let data = ''
    for (const line of message.split(/\r?\n/)) {
      if (line.startsWith('data:')) data += line.slice(5).trimStart()
      else if (line.startsWith('id:')) this.#last = line.slice(3).trim()
    }
    if (data) this.follower.event(JSON.parse(data) as Event)
  }
}
