/** The language of the page's own texts. English texts stand in the code and are the keys of the others. */
import { getContext, setContext } from 'svelte'
import ENGLISH from 'texts:en'
import { fetchAhead } from './chunk'
import { kept } from './kept.svelte'
import type de from './texts/de.json'

/** A text that has translations. */
export type Text = keyof typeof de
export type Language = 'en' | 'de' | 'ja'
export const LANGUAGES: Record<Language, string> = { en: 'English', de: 'Deutsch', ja: '日本語' }

type Texts = typeof ENGLISH
type Values = Record<string, string | number>
/** The text, with the values that it names. */
export type Say = (text: Text, values?: Values) => string

const isLanguage = (value: unknown): value is Language => typeof value === 'string' && Object.hasOwn(LANGUAGES, value)
/** The first language of the browser that the page has. */
const preferred = (): Language => navigator.languages.map((tag) => tag.split('-')[0]).find(isLanguage) ?? 'en'

/** The others come when they are chosen. */
const COMING: Record<Exclude<Language, 'en'>, () => Promise<{ default: Texts }>> = {
  de: () => import('texts:de'),
  ja: () => import('texts:ja'),
}

class Spoken {
  #chosen = kept<Language>('flip-language', (stored) => (isLanguage(stored) ? stored : preferred()))
  #texts = $state.raw<Texts>(ENGLISH)
  /** The language that is shown. */
  now = $state<Language>('en')
  /** The chosen one did not arrive, and the one before it stays. */
  lost = $state(false)
  #asked: Language = 'en'

  constructor() {
    $effect.root(() => {
      $effect(() => void this.show(this.#chosen.value))
    })
  }

  /** The chosen language, in this tab or in another one: shown, or on its way. */
  get chosen() {
    return this.#chosen.value
  }
  set chosen(language: Language) {
    this.#chosen.set(language)
  }
  /** In the language that is shown; in English where it has no such text. */
  say: Say = (text, values) => filled(this.#texts[text] ?? ENGLISH[text] ?? text, values)
  /** Whether a text, which may be the service's, is one of the page's own. */
  has = (text: string): text is Text => this.now === 'en' || text in this.#texts

  /** Resolves once it is shown or has not arrived; nothing to do where it is on its way already. */
  async show(language: Language): Promise<void> {
    if (language === this.#asked) return
    this.#asked = language
    this.lost = false
    try {
      const texts = language === 'en' ? ENGLISH : (await fetchAhead(language), await COMING[language]()).default
      if (language !== this.#asked) return
      this.#texts = texts
      this.now = language
      document.documentElement.lang = language
    } catch {
      if (language !== this.#asked) return
      this.lost = true
      this.#asked = this.now
    }
  }
}

const filled = (text: Texts[string], values?: Values) => (typeof text === 'string' ? text : text(values))

export const language = new Spoken()

/** In the reader's language, wherever it stands. */
export const t: Say = language.say

/** For what is in English whoever reads it, such as a CSV file. */
export const english: Say = (text, values) => filled(ENGLISH[text] ?? text, values)
const IN_ENGLISH = Symbol('in English')
/** To be called while a component is set up: what is in it is in English, if its view is not translated, or else in the reader's language. */
export const speakEnglish = (only: boolean) => setContext(IN_ENGLISH, only)
/** To be called while a component is set up: its texts in the language of the view in which it stands. */
export const texts = (): Say => (getContext(IN_ENGLISH) ? english : t)

/** Things in a row that make no sentence: `lot L7, vial V8`. */
export const listed = (items: (string | null | undefined | false)[]) => new Intl.ListFormat(language.now, { type: 'unit' }).format(items.filter((item): item is string => !!item))
