/** Reads the file of a film: the head, then radii, falls and frames, little-endian (crates/flip-sim/src/film.rs describes the layout). */
import type { FilmHead, HeapHead } from '../api/types'

/** A grain that left the spoon: when and where, and how fast, mm and mm/s in the room. */
export interface Fall {
  id: number
  /** Whether it falls into the vial's mouth. */
  reaches: boolean
  at: number
  from: [number, number, number]
  speed: [number, number, number]
}

/** Of a spoonful, unless it has another head. */
export interface Film<H = FilmHead> {
  head: H
  /** By id, mm; 0 for a grain that was never there. */
  radii: Float32Array
  falls: Fall[]
  /** Of each frame: s, degrees, mm. */
  times: Float32Array
  pitches: Float32Array
  shifts: Float32Array
  /** Of each frame and grain: x, y, z in the spoon, in steps of {@link STEP_MM}; {@link ABSENT} before the grain was there. */
  places: Int16Array
}

export type HeapFilm = Film<HeapHead>
export type AnyFilm = Film | HeapFilm

/** Whether a film is of a heap. */
export const isHeap = (film: AnyFilm): film is HeapFilm => 'base_radius_mm' in film.head

/** Length of a step of a position, mm. */
export const STEP_MM = 0.01
/** Where a grain is that was not recorded yet: no film reaches so far. */
export const ABSENT = -32768
const MAGIC = 'FLIPFILM'
const LAYOUT = 1

/** Why a file is no film that this page reads. */
export class UnreadableFilm extends Error {}

/** The film in a file; throws an {@link UnreadableFilm}. */
export function readFilm(buffer: ArrayBuffer): AnyFilm {
  const view = new DataView(buffer)
  const text = (from: number, length: number) => new TextDecoder().decode(new Uint8Array(buffer, from, length))
  if (buffer.byteLength < 16 || text(0, 8) !== MAGIC) throw new UnreadableFilm('This is no film.')
  const layout = view.getUint32(8, true)
  if (layout !== LAYOUT) throw new UnreadableFilm(`This film has layout ${layout}, this page reads layout ${LAYOUT}: reload the page.`)
  const length = view.getUint32(12, true)
  const head = JSON.parse(text(16, length)) as FilmHead | HeapHead
  let at = 16 + length
  const u16 = () => view.getUint16((at += 2) - 2, true)
  const i16 = () => view.getInt16((at += 2) - 2, true)
  const u32 = () => view.getUint32((at += 4) - 4, true)
  const f32 = () => view.getFloat32((at += 4) - 4, true)
  const { grains, frames } = head
  const radii = Float32Array.from({ length: grains }, () => u16() / 1000)
  const falls = Array.from({ length: head.falls }, (): Fall => ({ id: u16(), reaches: u16() === 1, at: f32(), from: [f32(), f32(), f32()], speed: [f32(), f32(), f32()] }))
  const [times, pitches, shifts] = [new Float32Array(frames), new Float32Array(frames), new Float32Array(frames)]
  const places = new Int16Array(frames * grains * 3).fill(ABSENT)
  for (let k = 0; k < frames; k++) {
    times[k] = f32()
    pitches[k] = f32()
    shifts[k] = f32()
    const row = k * grains * 3
    if (k > 0) places.copyWithin(row, row - grains * 3, row)
    for (let moved = u32(); moved > 0; moved--) {
      const cell = row + 3 * u16()
      places[cell] = i16()
      places[cell + 1] = i16()
      places[cell + 2] = i16()
    }
  }
  if (at !== buffer.byteLength) throw new UnreadableFilm('This film is not whole.')
  return { head, radii, falls, times, pitches, shifts, places } as AnyFilm
}
