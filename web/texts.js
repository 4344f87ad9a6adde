import MessageFormat from '@messageformat/core'
import compileModule from '@messageformat/core/compile-module.js'
import { readFileSync } from 'node:fs'
import { fileURLToPath } from 'node:url'

/** The languages into which the page is translated; the keys of their files are the English texts. */
export const TRANSLATED = ['de', 'ja']

/** The file of a language, and its texts by the English ones. */
export const fileOf = (language) => fileURLToPath(new URL(`src/texts/${language}.json`, import.meta.url))
export const textsOf = (language) => JSON.parse(readFileSync(fileOf(language), 'utf8'))

/** English is its own translation. Its plain texts stand in the components: only those with something to fill in are compiled. */
function englishTexts() {
  const keys = Object.keys(textsOf(TRANSLATED[0])).filter((key) => key.includes('{'))
  return Object.fromEntries(keys.map((key) => [key, key]))
}

/** A module with the texts of a language: plain ones as strings, ICU messages as functions, so that no browser parses or evaluates any. */
export function moduleOf(language) {
  const texts = Object.entries(language === 'en' ? englishTexts() : textsOf(language))
  const plain = texts.filter(([, text]) => !text.includes('{'))
  const formed = texts.filter(([, text]) => text.includes('{'))
  const code = compileModule(new MessageFormat(language), Object.fromEntries(formed)).replace('export default', 'const formed =')
  return `${code}\nexport default { ...${JSON.stringify(Object.fromEntries(plain))}, ...formed }`
}

const NAME = 'texts:'

/** Serves `texts:de` and its like to the bundler. */
export const texts = {
  name: 'flip-texts',
  resolveId: (id) => (id.startsWith(NAME) ? `\0${id}` : undefined),
  load(id) {
    if (!id.startsWith(`\0${NAME}`)) return
    const language = id.slice(NAME.length + 1)
    this.addWatchFile(fileOf(language === 'en' ? TRANSLATED[0] : language))
    return moduleOf(language)
  },
}

/** The language whose texts are this chunk of a build. */
export const languageOf = (chunk) => TRANSLATED.find((language) => chunk.moduleIds.includes(`\0${NAME}${language}`))
