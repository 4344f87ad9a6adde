/** Where everything is at one moment of a film, in the room: x along the spoon at rest, y across it, z up from its level rim; mm. */
import { ABSENT, isHeap, STEP_MM, type AnyFilm, type Fall } from './file'
import { heaped, type Spot } from './pile'

/** The simulator's gravity, mm/s². */
const GRAVITY = 9810
/** Depth to which a vial is drawn, mm; a real one is deeper. */
export const DEPTH_MM = 7.5
/** Part of its base's radius to which grains beside a heap are drawn as they fall. */
export const BELOW = 0.3

/** Parts of a moment's grain: centre, then radius. */
export const STRIDE = 4

export interface Moment {
  at: number
  pitch: number
  shift: number
  /** x, y, z and radius of each grain that is to be seen. */
  grains: Float32Array
  count: number
  /** Mass that has passed the mouth, mg. */
  vial_mg: number
  /** Which step, from 0. */
  step: number
}

interface Flight extends Fall {
  /** When it passes the level of the mouth, and when it comes to rest or leaves the picture. */
  mouth: number
  rests: number
  /** Where it lies in the vial; nothing beside it. */
  spot?: Spot
  mg: number
}

/** When a fall has come down to this height, s after it began. */
export function fallTime({ from, speed }: Fall, z: number): number {
  const v = speed[2]
  const height = Math.max(0, from[2] - z)
  return (v + Math.sqrt(v * v + 2 * GRAVITY * height)) / GRAVITY
}

/** A film that can be asked for any moment. */
export class Reel {
  readonly duration: number
  /** Lowest height that is drawn: the floor of the vial. */
  readonly floor: number
  readonly #flights: Flight[]
  readonly #left: Float64Array
  readonly #flightOf: (Flight | undefined)[]
  readonly #moment: Moment

  readonly #vial: { offset: number; mouth: number }

  constructor(readonly film: AnyFilm) {
    const { radii, falls } = film
    // A heap stands at rest, and what falls off it reaches nothing.
    const heap = isHeap(film)
    const head = heap
      ? { ...film.head, vial_radius_mm: 0, vial_offset_mm: 0, vial_mg: 0, drop_height_mm: BELOW * film.head.base_radius_mm }
      : film.head
    this.floor = -head.drop_height_mm - (heap ? 0 : DEPTH_MM)
    this.#vial = { offset: head.vial_offset_mm, mouth: -head.drop_height_mm }
    // The falls are in order of time, so that the first to land lies lowest.
    const spots = heap ? [] : heaped(falls.filter((f) => f.reaches).map((f) => landing(f, this.floor, head.vial_offset_mm)), head.vial_radius_mm, head.grain_mm)
    const cube = (id: number) => radii[id]! ** 3
    const reached = falls.filter((f) => f.reaches).reduce((sum, f) => sum + cube(f.id), 0)
    let next = 0
    this.#flights = falls.map((fall) => {
      const spot = fall.reaches ? spots[next++] : undefined
      const down = spot ? spot.z + this.floor : this.floor
      return { ...fall, spot, mouth: fall.at + fallTime(fall, this.#vial.mouth), rests: fall.at + fallTime(fall, down), mg: reached > 0 ? (head.vial_mg * cube(fall.id)) / reached : 0 }
    })
    this.#left = new Float64Array(head.grains).fill(Infinity)
    this.#flightOf = new Array<Flight | undefined>(head.grains)
    for (const flight of this.#flights) {
      this.#left[flight.id] = flight.at
      this.#flightOf[flight.id] = flight
    }
    this.duration = this.#flights.reduce((last, f) => Math.max(last, f.reaches ? f.rests : 0), head.duration_s)
    this.#moment = { at: NaN, pitch: 0, shift: 0, grains: new Float32Array(head.grains * STRIDE), count: 0, vial_mg: 0, step: 0 }
  }

  /** The step that is being made, from 0. */
  stepAt(at: number): number {
    if (isHeap(this.film)) return 0
    const { steps } = this.film.head
    return Math.max(0, steps.findLastIndex((s) => s.begins_s <= at + 1e-6))
  }

  /** Everything at this time; the same object each time. */
  at(at: number): Moment {
    const { head, radii, times, pitches, shifts, places } = this.film
    const moment = this.#moment
    if (moment.at === at) return moment
    const last = times.length - 1
    const k = Math.max(0, before(times, at))
    const next = Math.min(last, k + 1)
    const share = next > k ? Math.min(1, Math.max(0, (at - times[k]!) / (times[next]! - times[k]!))) : 0
    const mix = (values: Float32Array, u = share) => values[k]! + (values[next]! - values[k]!) * u
    moment.at = at
    moment.pitch = mix(pitches)
    moment.shift = mix(shifts)
    moment.step = this.stepAt(at)
    const [sin, cos] = turned(moment.pitch)
    const [sin0, cos0] = turned(pitches[k]!)
    const { grains } = moment
    let count = 0
    const put = (x: number, y: number, z: number, id: number) => {
      const cell = STRIDE * count++
      grains[cell] = x
      grains[cell + 1] = y
      grains[cell + 2] = z
      grains[cell + 3] = radii[id]!
    }
    const here = k * head.grains * 3
    const there = next * head.grains * 3
    moment.vial_mg = 0
    for (let id = 0; id < head.grains; id++) {
      if (radii[id] === 0) continue
      const flight = this.#flightOf[id]
      const a = here + 3 * id
      if (places[a] === ABSENT) continue
      if (flight && at >= flight.at) {
        if (at >= flight.mouth && flight.reaches) moment.vial_mg += flight.mg
        if (at < flight.rests) this.#falling(flight, at, put)
        else if (flight.spot) put(flight.spot.x + this.#vial.offset, flight.spot.y, flight.spot.z + this.floor, id)
        continue
      }
      if (flight && flight.at <= times[next]!) {
        // It leaves before the next frame: on its way to where it does.
        const along = places[a]! * STEP_MM + shifts[k]!
        const up = places[a + 2]! * STEP_MM
        const way = flight.at > times[k]! ? Math.max(0, at - times[k]!) / (flight.at - times[k]!) : 1
        const from = [along * cos0 + up * sin0, places[a + 1]! * STEP_MM, -along * sin0 + up * cos0]
        const at3 = [0, 1, 2].map((i) => from[i]! + (flight.from[i]! - from[i]!) * way)
        put(at3[0]!, at3[1]!, at3[2]!, id)
        continue
      }
      const b = there + 3 * id
      const along = (places[a]! + (places[b]! - places[a]!) * share) * STEP_MM + moment.shift
      const y = (places[a + 1]! + (places[b + 1]! - places[a + 1]!) * share) * STEP_MM
      const up = (places[a + 2]! + (places[b + 2]! - places[a + 2]!) * share) * STEP_MM
      put(along * cos + up * sin, y, -along * sin + up * cos, id)
    }
    moment.count = count
    return moment
  }

  #falling(flight: Flight, at: number, put: (x: number, y: number, z: number, id: number) => void) {
    const t = at - flight.at
    const { from, speed, id, spot } = flight
    const x = from[0] + speed[0] * t
    const y = from[1] + speed[1] * t
    const z = from[2] + speed[2] * t - (GRAVITY * t * t) / 2
    if (!spot || at < flight.mouth) return put(x, y, z, id)
    // Inside the vial it is led to where it comes to rest.
    const share = (at - flight.mouth) / Math.max(1e-9, flight.rests - flight.mouth)
    const m = flight.mouth - flight.at
    const [mx, my] = [from[0] + speed[0] * m, from[1] + speed[1] * m]
    put(mx + (spot.x + this.#vial.offset - mx) * share, my + (spot.y - my) * share, z, id)
  }
}

/** Where a fall would meet the floor, from the vial's axis. */
function landing(fall: Fall, floor: number, axis: number): { x: number; y: number } {
  const t = fallTime(fall, floor)
  return { x: fall.from[0] + fall.speed[0] * t - axis, y: fall.from[1] + fall.speed[1] * t }
}

function turned(degrees: number): [number, number] {
  const angle = (degrees * Math.PI) / 180
  return [Math.sin(angle), Math.cos(angle)]
}

/** The last of rising values that is not above this one; -1 if all are. */
function before(values: Float32Array, value: number): number {
  let [low, high] = [0, values.length]
  while (low < high) {
    const middle = (low + high) >> 1
    if (values[middle]! <= value) low = middle + 1
    else high = middle
  }
  return low - 1
}
