// Links of the Markdown and of the built pages, the size of the README, and words that the house does not use.
import fs from 'node:fs'
import path from 'node:path'
import { fileURLToPath } from 'node:url'
import { slugs } from './slugs.mjs'

const root = fileURLToPath(new URL('../../', import.meta.url))
const README_LINES = 150
const README_WORDS = 1200
const problems = []

const walk = (folder, end) => fs.readdirSync(path.join(root, folder), { withFileTypes: true, recursive: true })
  .filter(entry => entry.isFile() && entry.name.endsWith(end))
  .map(entry => path.relative(root, path.join(entry.parentPath, entry.name)))
const read = file => fs.readFileSync(path.join(root, file), 'utf8')
/** The text without what stands in code. */
const prose = text => text.replace(/^```[\s\S]*?^```/gm, '').replace(/`[^`\n]*`/g, '``')

// ---- Markdown: every link leads to a file of the repository, every anchor to a heading ----

function headings(file) {
  const slug = slugs()
  return new Set([...read(file).replace(/^```[\s\S]*?^```/gm, '').matchAll(/^#{1,6} (.+)$/gm)].map(match => slug(match[1].replace(/`/g, ''))))
}

const pages = [...fs.readdirSync(root).filter(name => name.endsWith('.md')), 'src/ARCHITECTURE.md', ...walk('docs', '.md')]
for (const page of pages) {
  for (const [, target] of prose(read(page)).matchAll(/\]\(([^)\s]+)\)/g)) {
    // Paths of Rust items are rustdoc's to check.
    if (/^[a-z]+:/.test(target) || /^(crate|flip_[a-z]+)(::|$)/.test(target)) continue
    const [file, anchor] = target.split('#')
    const there = file ? path.join(path.dirname(page), file) : page
    if (!fs.existsSync(path.join(root, there))) problems.push(`${page}: no ${target}`)
    else if (anchor && there.endsWith('.md') && !headings(there).has(anchor)) problems.push(`${page}: no heading for ${target}`)
  }
}

// ---- the navigation has every page, and no other ----

const nav = JSON.parse(read('web/docs/nav.json')).flatMap(section => section.pages.map(page => `docs/${page.file}.md`))
const written = walk('docs', '.md')
for (const page of written.filter(page => !nav.includes(page))) problems.push(`web/docs/nav.json: ${page} is missing`)
for (const page of nav.filter(page => !written.includes(page))) problems.push(`web/docs/nav.json: there is no ${page}`)

// ---- built pages: every address leads somewhere, nothing is inline ----

const html = fs.existsSync(path.join(root, 'web/docs-dist')) ? walk('web/docs-dist', '.html') : []
const ids = new Map(html.map(file => [file, new Set([...read(file).matchAll(/ id="([^"]+)"/g)].map(match => match[1]))]))
for (const file of html) {
  const text = read(file)
  for (const [, target] of text.matchAll(/ (?:href|src)="([^"]+)"/g)) {
    if (/^[a-z]+:/.test(target)) continue
    const [name, anchor] = target.split('#')
    const there = name ? path.join(path.dirname(file), decodeURI(name)) : file
    if (!fs.existsSync(path.join(root, there))) problems.push(`${file}: no ${target}`)
    else if (anchor && ids.has(there) && !ids.get(there).has(decodeURIComponent(anchor))) problems.push(`${file}: no ${target}`)
  }
  if (/<style|<script(?![^>]* src=)| style="| on[a-z]+="/.test(text.replace(/<pre>[\s\S]*?<\/pre>|<code>[\s\S]*?<\/code>/g, ''))) problems.push(`${file}: inline script or style`)
}

// ---- size and style ----

const readme = read('README.md')
const lines = readme.trimEnd().split('\n').length
const words = readme.split(/\s+/).filter(Boolean).length
if (lines > README_LINES || words > README_WORDS) problems.push(`README.md: ${lines} lines and ${words} words; at most ${README_LINES} and ${README_WORDS}`)

const rules = read('web/docs/style.txt').split('\n').filter(line => line && !line.startsWith('#')).map(line => line.split(/\s{2,}/))
// Decisions are a record and stay as they were written; generated pages are mended where they come from.
for (const page of pages.filter(page => page !== 'docs/decisions.md' && page !== 'src/ARCHITECTURE.md' && !read(page).includes('<!-- Made by'))) {
  prose(read(page)).split('\n').forEach((line, i) => {
    for (const [pattern, instead] of rules) {
      const hit = new RegExp(pattern, 'i').exec(line)
      if (hit) problems.push(`${page}: “${hit[0]}”: ${instead}`)
    }
  })
}

if (problems.length) {
  console.error(problems.join('\n'))
  process.exit(1)
}
console.log(`documentation: ${pages.length} files, ${html.length} pages, README of ${lines} lines and ${words} words`)
