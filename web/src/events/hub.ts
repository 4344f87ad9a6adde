/** Shares event streams among tabs: a browser has six connections to a host, and a stream holds one for its whole life. */
import type { Event } from '../api/types'
import { Stream, type Follower } from './stream'

/** A message from a tab, repeated at least every {@link BEAT_MS} while the tab is visible. */
export type Said = { kind: 'here'; token: string; visible: boolean } | { kind: 'gone' }
/** A message to a tab; `again`: reload everything, as no stream reports changes; `heard`: the worker is alive. */
export type Told = { kind: 'heard' } | { kind: 'again' } | { kind: 'open'; open: boolean } | { kind: 'event'; event: Event }

export interface Tab {
  tell(told: Told): void
}

export const BEAT_MS = 10_000
/** A tab silent for this long was closed without notice. */
const LOST_MS = 3 * BEAT_MS
/** Streams open at once. Each token has its own; two leave four connections for everything else. */
const STREAMS_MAX = 2
/** Tabs whose token got no stream reload this often. */
const POLL_MS = 5000

interface Seat {
  token: string
  heard: number
  /** What it was last told. */
  open?: boolean
}

interface Line {
  stream: { close(): void }
  open: boolean
}

export class Hub {
  /** Visible tabs, in the order they came. A hidden tab needs no events: it reloads when it is shown. */
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

  /** Tabs that fell silent lose their seat; those without a stream reload. */
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

  /** Reports whether events arrive, if that has changed; a line that has not reported yet does not count. */
  #tellOpen(tab: Tab, seat: Seat, said = false) {
    const open = this.#lines.get(seat.token)?.open ?? false
    if (seat.open === open || (!open && !said && seat.open === undefined)) return
    seat.open = open
    tab.tell({ kind: 'open', open })
  }
}
