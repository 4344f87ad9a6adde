/**
 * A drawing as a file. The marks are read off the page as they look, so SVG and PNG are what the reader sees, in the theme in use.
 * The PNG is painted mark by mark: under `default-src 'self'` a browser loads no image from memory, not even its own SVG.
 */

/** One mark with everything that its look needs. Lengths in CSS pixels. */
interface Mark {
  matrix: [number, number, number, number, number, number]
  fill: string | null
  stroke: string | null
  width: number
  dash: number[]
  opacity: number
  /** Drawn around the letters, beneath them. */
  halo?: { colour: string; width: number }
  path?: string
  text?: { content: string; size: number; weight: string; anchor: 'start' | 'middle' | 'end'; x: number; y: number }
}

/** An entry of the legend: a letter with its name, and how its line or its points look. */
export interface Entry {
  name: string
  colour: string
  dash?: string
}

export interface Picture {
  width: number
  height: number
  paper: string
  title: string
  marks: Mark[]
}

const FONT = "'Plex Sans', 'IBM Plex Sans', Helvetica, Arial, sans-serif"
const EDGE = 16
const ROW = 20

/** Any CSS colour as `#rrggbb` and its opacity: not every program that opens an SVG knows `oklab()`. */
function plainColour(colour: string, probe: CanvasRenderingContext2D): { hex: string; alpha: number } | null {
  if (colour === 'none') return null
  probe.clearRect(0, 0, 1, 1)
  probe.fillStyle = colour
  probe.fillRect(0, 0, 1, 1)
  const [r = 0, g = 0, b = 0, a = 0] = probe.getImageData(0, 0, 1, 1).data
  return a === 0 ? null : { hex: `#${[r, g, b].map((v) => v.toString(16).padStart(2, '0')).join('')}`, alpha: a / 255 }
}

function context(width: number, height: number): { canvas: HTMLCanvasElement; pen: CanvasRenderingContext2D } {
  const canvas = document.createElement('canvas')
  canvas.width = width
  canvas.height = height
  const pen = canvas.getContext('2d', { willReadFrequently: width === 1 })
  if (!pen) throw new Error('This browser has no canvas')
  return { canvas, pen }
}

const length = (element: Element, name: string) => Number(element.getAttribute(name) ?? 0)

function outline(element: Element): string | undefined {
  if (element.tagName === 'path') return element.getAttribute('d') ?? ''
  if (element.tagName === 'rect') return `M${length(element, 'x')} ${length(element, 'y')}h${length(element, 'width')}v${length(element, 'height')}h${-length(element, 'width')}z`
  return undefined
}

/** Everything in view in a drawing, in the order in which it is painted; what only helps a reader on the page (`data-page`) is left out. */
function marksOf(svg: SVGSVGElement, dx: number, dy: number): Mark[] {
  const probe = context(1, 1).pen
  const marks: Mark[] = []
  for (const element of svg.querySelectorAll<SVGGraphicsElement>('path, rect, text')) {
    if (element.closest('[data-page]')) continue
    const style = getComputedStyle(element)
    if (style.display === 'none' || style.visibility === 'hidden') continue
    let opacity = 1
    for (let e: Element | null = element; e && e !== svg; e = e.parentElement) opacity *= Number(getComputedStyle(e).opacity)
    const m = svg.getScreenCTM()?.inverse().multiply(element.getScreenCTM() as DOMMatrix)
    if (!m || opacity === 0) continue
    const [fill, stroke] = [plainColour(style.fill, probe), plainColour(style.stroke, probe)]
    const mark: Mark = {
      matrix: [m.a, m.b, m.c, m.d, m.e + dx, m.f + dy],
      fill: fill && fill.hex,
      stroke: stroke && stroke.hex,
      width: parseFloat(style.strokeWidth),
      dash: style.strokeDasharray === 'none' ? [] : style.strokeDasharray.split(/[\s,]+/).map(parseFloat),
      opacity: opacity * (fill?.alpha ?? stroke?.alpha ?? 1),
    }
    const path = outline(element)
    const anchor = style.textAnchor as 'start' | 'middle' | 'end'
    if (path !== undefined) marks.push({ ...mark, path })
    else if (element.textContent?.trim()) marks.push({ ...mark, stroke: null, halo: stroke && style.paintOrder.startsWith('stroke') ? { colour: stroke.hex, width: parseFloat(style.strokeWidth) } : undefined, text: { content: element.textContent.trim(), size: parseFloat(style.fontSize), weight: style.fontWeight, anchor, x: length(element, 'x'), y: length(element, 'y') } })
  }
  return marks
}

/** The drawing under its title and legend, on the colour of the sheet. */
export function pictureOf(svg: SVGSVGElement, title: string, legend: Entry[]): Picture {
  const probe = context(1, 1).pen
  const style = getComputedStyle(svg)
  const resolved = (colour: string) => {
    const span = document.createElement('span')
    svg.parentElement?.append(span)
    span.style.color = colour
    const found = plainColour(getComputedStyle(span).color, probe)?.hex ?? '#000000'
    span.remove()
    return found
  }
  const [ink, paper] = [resolved('var(--ink)'), resolved('var(--sheet)')]
  const box = svg.getBoundingClientRect()
  const width = Math.ceil(box.width) + 2 * EDGE
  const text = (content: string, x: number, y: number, size: number, weight: string): Mark => ({ matrix: [1, 0, 0, 1, 0, 0], fill: ink, stroke: null, width: 0, dash: [], opacity: 1, text: { content, size, weight, anchor: 'start', x, y } })
  const marks = [text(title, EDGE, EDGE + 12, 15, '600')]
  let [x, y] = [EDGE, EDGE + 12 + ROW]
  probe.font = `12px ${style.fontFamily}`
  for (const { name, colour, dash } of legend) {
    const room = 34 + probe.measureText(name).width + 18
    if (x > EDGE && x + room > width - EDGE) [x, y] = [EDGE, y + ROW]
    marks.push({ matrix: [1, 0, 0, 1, 0, 0], fill: null, stroke: resolved(colour), width: 2, dash: dash ? dash.split(' ').map(Number) : [], opacity: 1, path: `M${x} ${y - 4}h26` })
    marks.push(text(name, x + 34, y, 12, '400'))
    x += room
  }
  const top = y + (legend.length > 0 ? 12 : -8)
  return { width, height: Math.ceil(top + box.height + EDGE), paper, title, marks: [...marks, ...marksOf(svg, EDGE, top)] }
}

const escaped = (text: string) => text.replaceAll('&', '&amp;').replaceAll('<', '&lt;').replaceAll('>', '&gt;').replaceAll('"', '&quot;')
const short = (value: number) => String(Number(value.toFixed(3)))

/** A document of its own: no style sheet, no font and no script from elsewhere. */
export function svgText({ width, height, paper, title, marks }: Picture): string {
  const drawn = marks.map((mark) => {
    const moved = mark.matrix.map(short).join(' ') === '1 0 0 1 0 0' ? '' : ` transform="matrix(${mark.matrix.map(short).join(' ')})"`
    const stroke = mark.stroke ? ` stroke="${mark.stroke}" stroke-width="${short(mark.width)}"${mark.dash.length > 0 ? ` stroke-dasharray="${mark.dash.join(' ')}"` : ''}` : ''
    const halo = mark.halo ? ` stroke="${mark.halo.colour}" stroke-width="${short(mark.halo.width)}" stroke-linejoin="round" paint-order="stroke"` : ''
    const look = `${moved} fill="${mark.fill ?? 'none'}"${stroke}${mark.opacity < 1 ? ` opacity="${short(mark.opacity)}"` : ''}`
    if (!mark.text) return `<path d="${mark.path}"${look}/>`
    const { content, size, weight, anchor, x, y } = mark.text
    return `<text x="${short(x)}" y="${short(y)}" font-size="${short(size)}" font-weight="${weight}" text-anchor="${anchor}"${look}${halo}>${escaped(content)}</text>`
  })
  return `<?xml version="1.0" encoding="UTF-8"?>
<svg xmlns="http://www.w3.org/2000/svg" width="${width}" height="${height}" viewBox="0 0 ${width} ${height}" font-family="${escaped(FONT)}">
<title>${escaped(title)}</title>
<rect width="${width}" height="${height}" fill="${paper}"/>
${drawn.join('\n')}
</svg>
`
}

/** The same as pixels, `dense` to a CSS pixel. */
export function pngBlob({ width, height, paper, marks }: Picture, dense = 2): Promise<Blob> {
  const { canvas, pen } = context(width * dense, height * dense)
  pen.fillStyle = paper
  pen.fillRect(0, 0, canvas.width, canvas.height)
  pen.lineJoin = 'round'
  for (const { matrix: [a, b, c, d, e, f], fill, stroke, width: line, dash, opacity, halo, path, text } of marks) {
    pen.setTransform(a * dense, b * dense, c * dense, d * dense, e * dense, f * dense)
    pen.globalAlpha = opacity
    pen.lineWidth = line
    pen.setLineDash(dash)
    if (fill) pen.fillStyle = fill
    if (stroke) pen.strokeStyle = stroke
    if (text) {
      pen.font = `${text.weight} ${text.size}px ${FONT}`
      pen.textAlign = text.anchor === 'middle' ? 'center' : text.anchor
      if (halo) {
        pen.strokeStyle = halo.colour
        pen.lineWidth = halo.width
        pen.strokeText(text.content, text.x, text.y)
      }
      if (fill) pen.fillText(text.content, text.x, text.y)
    } else if (path) {
      const shape = new Path2D(path)
      if (fill) pen.fill(shape)
      if (stroke) pen.stroke(shape)
    }
  }
  return new Promise((resolve, reject) => canvas.toBlob((blob) => (blob ? resolve(blob) : reject(new Error('The picture is too large'))), 'image/png'))
}
