/** Shares event streams among tabs: a browser has six connections to a host, and a stream holds one for as long as it lives. */
import type { Event } from '../api/types'
import { Stream, type Follower } from './stream'

/** What a tab says. Said again at least every {@link BEAT_MS} while the tab can be seen. */
export type Said = { kind: 'here'; token: string; visible: boolean } | { kind: 'gone' }
/** What a tab is told; `again`: ask for everything anew, there is no stream that would say what changed; `heard`: the worker lives. */
export type Told = { kind: 'heard' } | { kind: 'again' } | { kind: 'open'; open: boolean } | { kind: 'event'; event: Event }

export interface Tab {
  tell(told: Told): void
}

export const BEAT_MS = 10_000
/** A tab that has not spoken for so long was closed without a word. */
const LOST_MS = 3 * BEAT_MS
/** Streams open at once. Each token has its own; two leave four connections for everything else. */
const STREAMS_MAX = 2
/** Tabs whose token got no stream ask anew this often. */
const POLL_MS = 5000

interface Seat {
  token: string
  heard: number
  /** What it was told last. */
  open?: boolean
}

interface Line {
  stream: { close(): void }
  open: boolean
}

export class Hub {
  /** Tabs that can be seen, in the order they came. A hidden one needs no events: it asks anew when it is shown. */
  #seats = new Map<Tab, Seat>()
  #lines = new Map<string, Line>()
  #timer: ReturnType<typeof setInterval> | undefined

  constructor(
    private readonly connect: (token: string, follower: Follower) => { close(): void } = (token, follower) => new Stream(token, follower),
    private readonly now = () => Date.now(),
  ) {}

  hear(tab: Tab, said: Said) {
    if (said.kind === 'gone' || !said.visible) this.#seats.delete(tab)
    else {
      const before = this.#seats.get(tab)
      const open = before?.token === said.token ? before.open : undefined
      this.#seats.set(tab, { token: said.token, heard: this.now(), open })
    }
    this.#settle()
  }

  /** Closes everything. */
  close() {
    this.#seats.clear()
    this.#settle()
  }

  /** Tabs that fell silent lose their seat; those without a stream ask anew. */
  beat() {
    for (const [tab, seat] of this.#seats) if (this.now() - seat.heard > LOST_MS) this.#seats.delete(tab)
    this.#settle()
    for (const [tab, seat] of this.#seats) if (!this.#lines.has(seat.token)) tab.tell({ kind: 'again' })
  }

  #settle() {
    const wanted = [...new Set([...this.#seats.values()].map((seat) => seat.token))].slice(0, STREAMS_MAX)
    for (const [token, line] of this.#lines) {
      if (wanted.includes(token)) continue
      this.#lines.delete(token)
      line.stream.close()
    }
    for (const token of wanted) if (!this.#lines.has(token)) this.#follow(token)
    for (const [tab, seat] of this.#seats) this.#tellOpen(tab, seat)
    if (this.#seats.size > 0) this.#timer ??= setInterval(() => this.beat(), POLL_MS)
    else {
      clearInterval(this.#timer)
      this.#timer = undefined
    }
  }

  #follow(token: string) {
    const each = (tell: (tab: Tab, seat: Seat) => void) => this.#seats.forEach((seat, tab) => seat.token === token && tell(tab, seat))
    const line: Line = { stream: { close() {} }, open: false }
    this.#lines.set(token, line)
    line.stream = this.connect(token, {
      open: (open) => {
        if (this.#lines.get(token) !== line) return
        line.open = open
        each((tab, seat) => this.#tellOpen(tab, seat, true))
      },
      event: (event) => {
        if (this.#lines.get(token) === line) each((tab) => tab.tell({ kind: 'event', event }))
      },
    })
  }

  /** Says whether events arrive, where that is news; a line that has said nothing yet is none. */
  #tellOpen(tab: Tab, seat: Seat, said = false) {
    const open = this.#lines.get(seat.token)?.open ?? false
    if (seat.open === open || (!open && !said && seat.open === undefined)) return
    seat.open = open
    tab.tell({ kind: 'open', open })
  }
}
