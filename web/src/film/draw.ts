/** Draws a moment of a film from the side: the spoon in section, its grains, the vial. */
import type { FilmHead, HeapHead } from '../api/types'
import { BELOW, DEPTH_MM, STRIDE, type Moment } from './moment'

/** Colours, as a canvas takes them. */
export interface Inks {
  ink: string
  muted: string
  rule: string
  glass: string
  /** Grains, from the farthest to the nearest. */
  grains: string[]
  /** Their edges. */
  edge: string
  font: string
  /** The lines of a fit, and their ground. */
  fit: string
  paper: string
}

/** How the room is mapped to the picture: pixels from mm. */
export interface View {
  width: number
  height: number
  scale: number
  x: (mm: number) => number
  y: (mm: number) => number
}

/** Room around what moves, mm. */
const MARGIN_MM = 1.2
/** Length of the handle that is drawn, mm. */
const HANDLE_MM = 60

/** Fits spoon, vial and everything between into a picture of this width. */
export function fit(head: FilmHead, width: number, heightMax = Infinity): View {
  const length = head.bowl_mm[0]!
  const left = -length - 3 * MARGIN_MM
  const right = Math.max(head.vial_offset_mm + head.vial_radius_mm, length) + MARGIN_MM
  // A pitched spoon raises its far end, and heaps rise above its rim. Only a steep one's handle is cut off.
  const top = 0.7 * length + MARGIN_MM
  const bottom = -head.drop_height_mm - DEPTH_MM - MARGIN_MM
  const scale = Math.min(width / (right - left), heightMax / (top - bottom))
  const slack = (width / scale - (right - left)) / 2
  return { width, height: Math.ceil((top - bottom) * scale), scale, x: (mm) => (mm - left + slack) * scale, y: (mm) => (top - mm) * scale }
}

/** Draws everything, from the back to the front. */
export function draw(ctx: CanvasRenderingContext2D, moment: Moment, head: FilmHead, view: View, inks: Inks): void {
  ctx.clearRect(0, 0, view.width, view.height)
  drawScale(ctx, view, inks, 5)
  drawLevel(ctx, head, view, inks)
  drawRim(ctx, moment, head, view, inks)
  drawGrains(ctx, moment, { mm: head.grain_mm, width: head.bowl_mm[1]!, reach: Math.max(head.bowl_mm[1]!, head.vial_radius_mm) }, view, inks)
  drawSpoon(ctx, moment, head, view, inks)
  drawVial(ctx, head, view, inks)
}

function drawScale(ctx: CanvasRenderingContext2D, view: View, inks: Inks, mm: number) {
  const [x, y] = [12, view.height - 14]
  const length = mm * view.scale
  ctx.strokeStyle = inks.muted
  ctx.lineWidth = 1
  ctx.beginPath()
  ctx.moveTo(x + 0.5, y - 4)
  ctx.lineTo(x + 0.5, y + 0.5)
  ctx.lineTo(x + length, y + 0.5)
  ctx.lineTo(x + length, y - 4)
  ctx.stroke()
  ctx.fillStyle = inks.muted
  ctx.font = inks.font
  ctx.textAlign = 'left'
  ctx.fillText(`${mm} mm`, x + 4, y - 5)
}

/** The level through the middle of the spoon at rest: what the pitch is measured from. */
function drawLevel(ctx: CanvasRenderingContext2D, head: FilmHead, view: View, inks: Inks) {
  ctx.strokeStyle = inks.rule
  ctx.lineWidth = 1
  ctx.setLineDash([3, 4])
  ctx.beginPath()
  ctx.moveTo(view.x(-head.bowl_mm[0]! - 2 * MARGIN_MM), view.y(0))
  ctx.lineTo(view.x(head.bowl_mm[0]! + 2 * MARGIN_MM), view.y(0))
  ctx.stroke()
  ctx.setLineDash([])
  ctx.fillStyle = inks.muted
  ctx.font = inks.font
  ctx.textAlign = 'left'
  ctx.fillText('level', view.x(-head.bowl_mm[0]! - 2 * MARGIN_MM), view.y(0) + 14)
}

/** Most layers into which grains are sorted across the picture. */
const LAYERS_MAX = 80

/** Grains in layers about as thick as they are, the farthest first, so that nearer ones cover those behind them. */
function drawGrains(ctx: CanvasRenderingContext2D, moment: Moment, { mm, width, reach }: { mm: number; width: number; reach: number }, view: View, inks: Inks) {
  const layers = Math.min(LAYERS_MAX, Math.ceil((2 * reach) / mm))
  const { grains, count } = moment
  const members: number[][] = Array.from({ length: layers }, () => [])
  for (let cell = 0; cell < count * STRIDE; cell += STRIDE) {
    const share = (reach - grains[cell + 1]!) / (2 * reach)
    members[Math.min(layers - 1, Math.max(0, Math.floor(share * layers)))]!.push(cell)
  }
  const hasEdges = view.scale * mm > 3
  ctx.strokeStyle = inks.edge
  ctx.lineWidth = 0.6
  members.forEach((cells, layer) => {
    if (cells.length === 0) return
    ctx.beginPath()
    for (const cell of cells) {
      const [x, y, r] = [view.x(grains[cell]!), view.y(grains[cell + 2]!), grains[cell + 3]! * view.scale]
      ctx.moveTo(x + r, y)
      ctx.arc(x, y, r, 0, 2 * Math.PI)
    }
    // Shades span the width of the bowl or the base; what lies beyond has the last.
    const depth = reach - ((layer + 0.5) / layers) * 2 * reach
    const shade = Math.floor(((width - depth) / (2 * width)) * inks.grains.length)
    ctx.fillStyle = inks.grains[Math.min(inks.grains.length - 1, Math.max(0, shade))]!
    ctx.fill()
    if (hasEdges) ctx.stroke()
  })
}

/** Into the spoon's frame, in mm, y down. */
function intoSpoon(ctx: CanvasRenderingContext2D, moment: Moment, view: View) {
  ctx.translate(view.x(0), view.y(0))
  ctx.rotate((moment.pitch * Math.PI) / 180)
  ctx.scale(view.scale, view.scale)
  ctx.translate(moment.shift, 0)
}

/** The far rim of the bowl, behind the powder. */
function drawRim(ctx: CanvasRenderingContext2D, moment: Moment, head: FilmHead, view: View, inks: Inks) {
  ctx.save()
  intoSpoon(ctx, moment, view)
  ctx.beginPath()
  ctx.moveTo(-head.bowl_mm[0]!, 0)
  ctx.lineTo(head.bowl_mm[0]!, 0)
  ctx.restore()
  ctx.strokeStyle = inks.rule
  ctx.lineWidth = 1
  ctx.stroke()
}

/** The bowl's section along its middle, and the handle. */
function drawSpoon(ctx: CanvasRenderingContext2D, moment: Moment, head: FilmHead, view: View, inks: Inks) {
  const [length, , depth] = head.bowl_mm as [number, number, number]
  ctx.save()
  intoSpoon(ctx, moment, view)
  ctx.beginPath()
  ctx.moveTo(-length - HANDLE_MM, -0.6)
  ctx.lineTo(-length, 0)
  // Tip down is clockwise on a screen, whose y points down: the lower half is that of positive y.
  ctx.ellipse(0, 0, length, depth, 0, Math.PI, 0, true)
  ctx.restore()
  ctx.strokeStyle = inks.ink
  ctx.lineWidth = 2
  ctx.lineCap = 'round'
  ctx.lineJoin = 'round'
  ctx.stroke()
}

/** The vial from its mouth to its floor, cut short. */
function drawVial(ctx: CanvasRenderingContext2D, head: FilmHead, view: View, inks: Inks) {
  const wall = (side: number) => view.x(head.vial_offset_mm + side * head.vial_radius_mm)
  const [mouth, floor] = [view.y(-head.drop_height_mm), view.y(-head.drop_height_mm - DEPTH_MM)]
  const cut = mouth + 0.55 * (floor - mouth)
  ctx.strokeStyle = inks.glass
  ctx.lineWidth = 1.5
  ctx.lineCap = 'butt'
  ctx.beginPath()
  for (const side of [-1, 1]) {
    const x = wall(side)
    ctx.moveTo(x + side * 0.35 * view.scale, mouth)
    ctx.lineTo(x, mouth)
    ctx.lineTo(x, cut - 3)
    ctx.moveTo(x, cut + 3)
    ctx.lineTo(x, floor)
    // Where the vial is cut short.
    for (const up of [-3, 3]) {
      ctx.moveTo(x - 5, cut + up + 2)
      ctx.lineTo(x + 5, cut + up - 2)
    }
  }
  ctx.moveTo(wall(-1), floor)
  ctx.lineTo(wall(1), floor)
  ctx.stroke()
}

/** How much wider than its base the picture of a heap is. */
export const AROUND = 1.5

/** Fits a heap into a picture of this width: its base takes the same part of it as that of a pile under a camera. */
export function fitHeap(head: HeapHead, width: number): View {
  const half = AROUND * head.base_radius_mm
  // Grains leave an opening that stays three of them above the apex.
  const top = Math.max(head.height_mm, head.cone_height_mm) + 4.5 * head.grain_mm
  const bottom = -BELOW * head.base_radius_mm
  const scale = width / (2 * half)
  return { width, height: Math.ceil((top - bottom) * scale), scale, x: (mm) => (mm + half) * scale, y: (mm) => (top - mm) * scale }
}

/** A heap from the side; with its fit, the lines that its angles come from. */
export function drawHeap(ctx: CanvasRenderingContext2D, moment: Moment, head: HeapHead, view: View, inks: Inks, fitted: boolean): void {
  ctx.clearRect(0, 0, view.width, view.height)
  drawScale(ctx, view, inks, 1)
  const radius = head.base_radius_mm
  drawGrains(ctx, moment, { mm: head.grain_mm, width: radius, reach: AROUND * radius }, view, inks)
  ctx.fillStyle = inks.ink
  ctx.fillRect(view.x(-radius), view.y(0), 2 * radius * view.scale, 3)
  if (fitted) drawFit(ctx, head, view, inks)
}

/** The cone through the rings of the flank, solid where it was fitted, and the way from the apex to the rim. */
function drawFit(ctx: CanvasRenderingContext2D, head: HeapHead, view: View, inks: Inks) {
  const { base_radius_mm: radius, height_mm: apex, cone_height_mm: point } = head
  const slope = Math.tan((head.cone_deg * Math.PI) / 180)
  const line = (from: [number, number], to: [number, number], width: number, dash: number[]) => {
    for (const [ink, wide, dashes] of [[inks.paper, width + 2, []], [inks.fit, width, dash]] as const) {
      ctx.setLineDash([...dashes])
      ctx.strokeStyle = ink
      ctx.lineWidth = wide
      ctx.beginPath()
      ctx.moveTo(view.x(from[0]), view.y(from[1]))
      ctx.lineTo(view.x(to[0]), view.y(to[1]))
      ctx.stroke()
    }
    ctx.setLineDash([])
  }
  ctx.lineCap = 'butt'
  for (const side of [-1, 1]) {
    const at = (z: number): [number, number] => [(side * (point - z)) / slope, z]
    line([0, apex], [side * radius, 0], 1.4, [2, 4])
    line(at(point), at(0), 1.2, [7, 5])
    line(at(0.8 * apex), at(0.2 * apex), 2.4, [])
  }
  ctx.fillStyle = inks.fit
  for (const ring of head.rings) {
    // Sectors begin opposite to x: the first and the last quarter lie to the left.
    const side = ring.sector < 3 || ring.sector >= 9 ? -1 : 1
    ctx.beginPath()
    ctx.arc(view.x(side * ring.radius_mm), view.y(ring.height_mm), 2.2, 0, 2 * Math.PI)
    ctx.fill()
  }
  ctx.strokeStyle = inks.fit
  ctx.lineWidth = 2
  ctx.beginPath()
  ctx.arc(view.x(0), view.y(apex), 5, 0, 2 * Math.PI)
  ctx.stroke()
}
