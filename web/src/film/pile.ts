/** Where grains lie in the vial. The simulator counts them at the mouth; this only draws them: each lies where it lands, or rolls down to a neighbouring place that is lower by two grains. */

export interface Spot {
  /** From the vial's axis, and above its floor, mm. */
  x: number
  y: number
  z: number
}

/** Height of a layer of a loose packing, in grain diameters. */
const LAYER = 0.8
const AROUND = [[1, 0], [0, 1], [-1, 0], [0, -1], [1, 1], [-1, 1], [-1, -1], [1, -1]] as const

/** Spots of grains with this diameter that land in this order, from the axis, in a vial of this radius; mm. */
export function heaped(landings: { x: number; y: number }[], radius: number, diameter: number): Spot[] {
  const within = Math.max(0, radius - diameter / 2)
  const half = Math.ceil(within / diameter)
  const side = 2 * half + 1
  const heights = new Uint16Array(side * side)
  const isInside = (i: number, j: number) => Math.hypot(i, j) * diameter <= within
  const height = (i: number, j: number) => heights[(i + half) * side + j + half]!
  return landings.map(({ x, y }, k) => {
    // The wall keeps it in.
    const off = Math.hypot(x, y)
    const scale = off > within ? within / off : 1
    let [i, j] = [Math.round((x * scale) / diameter), Math.round((y * scale) / diameter)]
    if (!isInside(i, j)) [i, j] = [Math.trunc((x * scale) / diameter), Math.trunc((y * scale) / diameter)]
    for (;;) {
      let lowest: readonly [number, number] | undefined
      for (const [di, dj] of AROUND) {
        const [a, b] = [i + di, j + dj]
        if (isInside(a, b) && height(a, b) + 1 < height(i, j) && (!lowest || height(a, b) < height(...lowest))) lowest = [a, b]
      }
      if (!lowest) break
      ;[i, j] = lowest
    }
    const layer = heights[(i + half) * side + j + half]!++
    // Alternate layers are shifted, as grains lie in the gaps of those below.
    const nudge = ((layer % 2) - 0.5) * 0.4 + (((k * 7919) % 13) / 13 - 0.5) * 0.3
    return { x: (i + nudge) * diameter, y: j * diameter, z: (0.5 + LAYER * layer) * diameter }
  })
}
