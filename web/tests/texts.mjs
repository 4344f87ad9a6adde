/** What the page says, read from its source: the texts that it hands to a translation, and literal texts that it does not. */
import { readdirSync, readFileSync } from 'node:fs'
import { join, relative } from 'node:path'
import { fileURLToPath } from 'node:url'
import { parse } from 'svelte/compiler'

const SRC = fileURLToPath(new URL('../src', import.meta.url))

/** The syntax tree of every component and script, by its path below src. */
export function sources() {
  const names = readdirSync(SRC, { recursive: true }).filter((name) => /\.(svelte|ts)$/.test(name) && !name.endsWith('.d.ts'))
  return new Map(names.map((name) => [relative(SRC, join(SRC, name)), tree(name, readFileSync(join(SRC, name), 'utf8'))]))
}

/** A script is read as that of a component without anything to show. */
export function tree(name, text) {
  return parse(name.endsWith('.svelte') ? text : `<script lang="ts">${text}</script>`, { modern: true })
}

/** Calls `visit` for a node and what is in it, until that returns false. */
function walk(node, visit) {
  if (Array.isArray(node)) return node.forEach((it) => walk(it, visit))
  if (!node || typeof node !== 'object') return
  if (typeof node.type === 'string' && visit(node) === false) return
  for (const [key, value] of Object.entries(node)) if (key !== 'parent' && value && typeof value === 'object') walk(value, visit)
}

const isSay = (node) => node.type === 'CallExpression' && node.callee.name === 't'

/** The texts that a source says, with the names of the values that go with them; undefined where these are not listed. */
export function said(source) {
  const found = []
  walk(source, (node) => {
    if (!isSay(node)) return
    const [text, values] = node.arguments
    const names = values === undefined ? [] : values.type === 'ObjectExpression' ? values.properties.map((it) => it.key?.name) : undefined
    walk(text, (part) => {
      // The condition of a choice is no text.
      if (part.type === 'ConditionalExpression') {
        for (const branch of [part.consequent, part.alternate]) walk(branch, (leaf) => leaf.type === 'Literal' && typeof leaf.value === 'string' && found.push({ text: leaf.value, names }))
        return false
      }
      if (part.type === 'LogicalExpression' || part.type === 'TSAsExpression' || part.type === 'MemberExpression' || part.type === 'CallExpression') {
        if (part.type === 'LogicalExpression' && part.right.type === 'Literal') found.push({ text: part.right.value, names })
        return false
      }
      if (part.type === 'Literal' && typeof part.value === 'string') found.push({ text: part.value, names })
    })
  })
  return found
}

/** Every string in a source. */
export function strings(source) {
  const found = new Set()
  walk(source, (node) => {
    if (node.type === 'Literal' && typeof node.value === 'string') found.add(node.value)
  })
  return found
}

/** Attributes that a person reads or hears. */
const SPOKEN = ['aria-label', 'aria-valuetext', 'aria-description', 'alt', 'title', 'placeholder', 'label', 'hint', 'caption', 'empty', 'begin', 'summary', 'message']
/** Names and units, the same in every language. */
const SAME = /FLIP|CSV|USP|flip_\S*|\b(?:mg|g|s|ms|min)\b/g
const isProse = (text) => /\p{Letter}{2,}/u.test(text.replaceAll(SAME, ''))

/** Literal texts that a component shows without a translation. */
export function untranslated(source) {
  const found = []
  const literals = (node) =>
    walk(node, (part) => {
      if (isSay(part)) return false
      // A comparison shows nothing, and a name of a state is no sentence.
      if (part.type === 'BinaryExpression' && part.operator !== '+') return false
      if (part.type === 'Literal' && typeof part.value === 'string' && isProse(part.value) && /^\p{Uppercase}|\s\S/u.test(part.value)) found.push(part.value)
      if (part.type === 'TemplateElement' && isProse(part.value.raw) && /\s/.test(part.value.raw.trim())) found.push(part.value.raw)
    })
  walk(source.fragment, (node) => {
    if (node.type === 'Component' && node.name === 'English') return false
    if (node.type === 'RegularElement' && ['code', 'style', 'option'].includes(node.name) && node.attributes.length === 0) return false
    if (node.type === 'StyleDirective' || node.type === 'ClassDirective') return false
    if (node.type === 'Text' && isProse(node.data)) found.push(node.data.trim())
    if (node.type === 'Attribute') {
      if (!SPOKEN.includes(node.name)) return false
      for (const part of [node.value].flat()) {
        if (part.type === 'Text' && isProse(part.data)) found.push(part.data)
        else literals(part.expression)
      }
      return false
    }
    if (node.type === 'ExpressionTag') {
      literals(node.expression)
      return false
    }
  })
  return found
}

/** Whether a component has its texts translated. */
export const isTranslated = (source) => said(source).length > 0
