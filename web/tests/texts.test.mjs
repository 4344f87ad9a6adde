/** Translations are whole: every text in every language, with the same values and tags, and no text left out of it. */
import assert from 'node:assert/strict'
import { describe, it } from 'node:test'
import MessageFormat from '@messageformat/core'
import { parse } from '@messageformat/parser'
import { TRANSLATED, textsOf } from '../texts.js'
import { isTranslated, said, sources, strings, tree, untranslated } from './texts.mjs'

const SOURCES = sources()
const tables = Object.fromEntries(TRANSLATED.map((language) => [language, textsOf(language)]))
const [FIRST] = TRANSLATED
/** The values that a message names, or only those that it shows, in the order of the alphabet. */
const valuesOf = (text, type) => (text.includes('{') ? [...new Set(named(parse(text), type))].sort() : [])
const named = (tokens, type) => tokens.flatMap((it) => [...(it.arg && it.type === (type ?? it.type) ? [it.arg] : []), ...(it.cases ?? []).flatMap(({ tokens }) => named(tokens, type))])
/** Its tags, each as often as it stands there. */
const tagsOf = (text) => [...text.matchAll(/<(\w+)>.*?<\/\1>/g)].map(([, name]) => name).sort()

/** What has no place of its own in the code: words of the service that are shown through a translation. */
const OF_THE_SERVICE = ['The request is not valid', 'A valid token is needed', 'Not allowed', 'Conflicts with the present state', 'Balance', 'Arm', 'Gripper', 'Camera', 'Weighing', 'Job']

describe('what a component says', () => {
  it('has a translation into every language', () => {
    for (const [name, source] of SOURCES) for (const { text } of said(source)) for (const language of TRANSLATED) assert.ok(text in tables[language], `${name}: “${text}” is not in ${language}.json`)
  })

  it('comes with the values that its text names', () => {
    for (const [name, source] of SOURCES) for (const { text, names } of said(source)) for (const value of names ? valuesOf(text) : []) assert.ok(names.includes(value), `${name}: “${text}” is given no ${value}`)
  })

  it('is all that it shows: no literal text stands beside it', () => {
    const found = [...SOURCES].filter(([name, source]) => name.endsWith('.svelte') && isTranslated(source)).flatMap(([name, source]) => untranslated(source).map((text) => `${name}: “${text}”`))
    assert.deepEqual(found, [])
  })

  it('is found where it is not translated', () => {
    const of = (text) => untranslated(tree('A.svelte', text))
    assert.deepEqual(of('<p>Nothing moves.</p>'), ['Nothing moves.'])
    assert.deepEqual(of('<p aria-label="Views">{t("Views")}</p>'), ['Views'])
    assert.deepEqual(of('<p>{moves ? "Moves now" : t("Ready")}</p>'), ['Moves now'])
    assert.deepEqual(of('<Field label={`Mass of ${powder}`} />'), ['Mass of '])
    assert.deepEqual(of('<English><p>A report</p></English><p class="a b">{num(mass)} mg</p>'), [])
  })
})

describe('a translation', () => {
  it('has the same texts in every language, and none that nothing says', () => {
    const used = new Set([...SOURCES.values()].flatMap((source) => [...strings(source)]))
    for (const language of TRANSLATED) {
      assert.deepEqual(Object.keys(tables[language]), Object.keys(tables[FIRST]), language)
      assert.deepEqual(Object.keys(tables[language]).filter((text) => !used.has(text) && !OF_THE_SERVICE.includes(text)), [], language)
    }
  })

  it('is empty nowhere, and has the values and tags of the English text', () => {
    for (const language of TRANSLATED)
      for (const [english, text] of Object.entries(tables[language])) {
        assert.ok(text.trim(), `${language}: “${english}”`)
        for (const type of [undefined, 'argument']) assert.deepEqual(valuesOf(text, type), valuesOf(english, type), `${language}: “${english}”`)
        assert.deepEqual(tagsOf(text), tagsOf(english), `${language}: “${english}”`)
      }
  })

  it('leaves numbers as they are: a # would group their digits', () => {
    for (const language of TRANSLATED) for (const text of Object.entries(tables[language]).flat()) assert.doesNotMatch(text, /#/, language)
  })

  it('has the plural of its language', () => {
    const english = '{n, plural, one {One dose is waiting.} other {{n} doses are waiting.}}'
    const text = (language, n) => new MessageFormat(language).compile(tables[language]?.[english] ?? english)({ n })
    assert.deepEqual([1, 2].map((n) => text('en', n)), ['One dose is waiting.', '2 doses are waiting.'])
    assert.deepEqual([1, 2].map((n) => text('de', n)), ['Eine Einwaage wartet.', '2 Einwaagen warten.'])
    assert.deepEqual([1, 2000].map((n) => text('ja', n)), ['1 件の秤量が待機中です。', '2000 件の秤量が待機中です。'])
  })
})
