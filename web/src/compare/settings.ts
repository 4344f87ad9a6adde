/** Settings as axes of parallel coordinates. */
import { flat } from '../flat'
import { NONE, words } from '../format'
import type { Dimension, Value } from './parallel'

/** One axis for every setting with more than one value, numbers as numbers. What some lack altogether is left to the table. */
export function settingAxes(documents: unknown[]): Dimension[] {
  const flats = documents.map((it) => new Map(flat(it)))
  const names = [...new Set(flats.flatMap((it) => [...it.keys()]))]
  return names
    .map((name) => ({ name, texts: flats.map((it) => it.get(name)) }))
    .filter(({ texts }) => new Set(texts.filter((text) => text !== undefined && text !== NONE)).size > 1)
    .filter((it, k, every) => !every.slice(0, k).some((other) => same(it, other)))
    .map(({ name, texts }) => ({ key: name, label: words(name.split('.').filter((part) => part !== 'settings').slice(-2).join(' ')), values: valuesOf(texts) }))
}

interface Varied {
  name: string
  texts: (string | undefined)[]
}
/** The same setting written twice: under the same last name, and nowhere with another value. */
const same = (a: Varied, b: Varied) => a.name.split('.').at(-1) === b.name.split('.').at(-1) && a.texts.every((text, k) => text === undefined || b.texts[k] === undefined || text === b.texts[k])

function valuesOf(texts: (string | undefined)[]): Value[] {
  const given = texts.filter((text): text is string => text !== undefined && text !== NONE)
  const numbers = given.every((text) => text !== '' && Number.isFinite(Number(text)))
  return texts.map((text) => (text === undefined || text === NONE ? null : numbers ? Number(text) : text))
}
