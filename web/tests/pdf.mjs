/** What a PDF of Chromium holds, page by page: its text as it can be copied, and its drawing operators. */
import { inflateSync } from 'node:zlib'

export function pagesOf(bytes) {
  const file = bytes.toString('latin1')
  const objects = new Map()
  for (const [, number, body] of file.matchAll(/(\d+) 0 obj\s([\s\S]*?)endobj/g)) objects.set(Number(number), body)
  const stream = (number) => {
    const body = objects.get(number) ?? ''
    const [, head, data] = /^([\s\S]*?)stream\r?\n([\s\S]*?)\r?\nendstream/.exec(body) ?? []
    if (data === undefined) return ''
    const raw = Buffer.from(data, 'latin1')
    return (/FlateDecode/.test(head) ? inflateSync(raw) : raw).toString('latin1')
  }
  const refs = (text, key) => [...(new RegExp(`/${key}\\s*\\[?((?:\\s*\\d+ 0 R)+)`).exec(text)?.[1] ?? '').matchAll(/(\d+) 0 R/g)].map(([, n]) => Number(n))

  const maps = new Map()
  function glyphs(font) {
    if (!maps.has(font)) {
      const map = new Map()
      const text = stream(refs(objects.get(font) ?? '', 'ToUnicode')[0])
      const hex = (h) => String.fromCharCode(...(h.match(/.{4}/g) ?? []).map((c) => parseInt(c, 16)))
      for (const [, block] of text.matchAll(/beginbfchar([\s\S]*?)endbfchar/g)) for (const [, from, to] of block.matchAll(/<(\w+)>\s*<(\w+)>/g)) map.set(parseInt(from, 16), hex(to))
      for (const [, block] of text.matchAll(/beginbfrange([\s\S]*?)endbfrange/g))
        for (const [, from, to, first] of block.matchAll(/<(\w+)>\s*<(\w+)>\s*<(\w+)>/g))
          for (let k = parseInt(from, 16); k <= parseInt(to, 16); k++) map.set(k, String.fromCharCode(parseInt(first, 16) + k - parseInt(from, 16)))
      maps.set(font, map)
    }
    return maps.get(font)
  }

  return [...objects.values()].filter((body) => /\/Type\s*\/Page\b/.test(body)).map((page) => {
    const fonts = Object.fromEntries([...(/\/Font\s*<<([\s\S]*?)>>/.exec(page)?.[1] ?? '').matchAll(/\/(\w+) (\d+) 0 R/g)].map(([, name, n]) => [name, Number(n)]))
    const drawn = refs(page, 'Contents').map(stream).join('\n')
    let [map, text] = [new Map(), '']
    for (const [, font, run] of drawn.matchAll(/\/(\w+) [\d.]+ Tf|<([0-9A-Fa-f]+)>/g)) {
      if (font) map = glyphs(fonts[font])
      else text += (run.match(/.{4}/g) ?? []).map((c) => map.get(parseInt(c, 16)) ?? '').join('')
    }
    const [, width, height] = /MediaBox\s*\[\s*0 0 ([\d.]+) ([\d.]+)/.exec(page) ?? []
    return { text, drawn, width: Number(width), height: Number(height) }
  })
}
