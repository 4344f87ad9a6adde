/** The dose that moves, as the console and the wall screen show it, and the newest one before it. */
import { weighing, weighings } from './api/calls'
import { benchNow } from './bench.svelte'
import { mean } from './format'
import { live, ofWeighings } from './live.svelte'
import { Resource } from './resource.svelte'
import { readingDecimals } from './weighing'

/** Doses of the same powder from which the time of this one is estimated. */
const ALIKE = 10

/** To be made while a view is set up: it lives as long as the view. */
export class DoseNow {
  #now = new Resource(async () => {
    const moving = benchNow.value?.moving
    return moving ? await weighing(moving) : undefined
  })
  #last = new Resource(async () => (await weighings({ state: 'done', limit: 1 })).items[0])
  #alike = new Resource(async () => {
    const powder = this.weighing?.powder
    if (!powder) return []
    const { items } = await weighings({ powder, state: 'done', limit: ALIKE })
    return items.flatMap((w) => (w.started_at && w.finished_at ? [(Date.parse(w.finished_at) - Date.parse(w.started_at)) / 1000] : []))
  })
  #clock = $state(Date.now())

  constructor() {
    const reload = () => void Promise.all([this.#now.reload(), this.#last.reload()])
    let asked: string | null | undefined
    let powder: string | undefined
    $effect(() => live.reloads(ofWeighings, reload))
    $effect(() => {
      const moving = benchNow.value?.moving
      if (moving !== asked) reload()
      asked = moving
    })
    $effect(() => {
      if (this.weighing && this.weighing.powder !== powder) void this.#alike.reload()
      powder = this.weighing?.powder
    })
    $effect(() => {
      const timer = setInterval(() => (this.#clock = Date.now()), 1000)
      return () => clearInterval(timer)
    })
  }

  get weighing() {
    const moving = benchNow.value?.moving
    return moving && this.#now.value?.weighing.id === moving ? this.#now.value.weighing : undefined
  }
  get last() {
    return this.#last.value
  }
  get #ticks() {
    return this.weighing ? (this.#now.value?.ticks ?? []) : []
  }
  /** What the balance shows, mg. */
  get reading() {
    return this.#ticks.at(-1)?.reading.mass_mg
  }
  get decimals() {
    return readingDecimals(this.#ticks.map((tick) => tick.reading.mass_mg))
  }
  /** Since the bench was armed, s. */
  get elapsed() {
    const started = this.weighing?.started_at
    return started ? Math.max(0, (this.#clock - Date.parse(started)) / 1000) : undefined
  }
  /** About how long it will still take, s, from earlier doses of this powder; unknown without any, or beyond their time. */
  get left() {
    const usual = mean(this.#alike.value ?? [])
    const left = usual === null || this.elapsed === undefined ? 0 : usual - this.elapsed
    return left > 0 ? left : undefined
  }
}
