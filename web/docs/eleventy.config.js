// The pages of ../../docs, as plain files that run under `default-src 'self'`: no inline script or style, nothing from elsewhere.
import fs from 'node:fs'
import path from 'node:path'
import { slugs } from './slugs.mjs'

const nav = JSON.parse(fs.readFileSync(new URL('nav.json', import.meta.url), 'utf8'))
const places = nav.flatMap(section => section.pages.map(page => ({ ...page, section: section.title })))

/** Where a page is, seen from another: `../how-to/bench.html`. */
const relative = (from, to) => path.posix.relative(path.posix.dirname(from), to)

/** Links as they work in the repository become links of the site; those to other files of the repository become their names. */
function links(md) {
  const open = md.renderer.rules.link_open ?? ((tokens, i, options, env, self) => self.renderToken(tokens, i, options))
  md.core.ruler.push('links', state => {
    for (const token of state.tokens) {
      let outside = false
      for (const child of token.children ?? []) {
        const target = child.type === 'link_open' && child.attrGet('href')
        if (target && !/^[a-z]+:|^#/.test(target)) {
          const [file, anchor] = target.split('#')
          const here = path.posix.dirname(state.env.page.inputPath.replace(/^.*?docs\//, ''))
          outside = path.posix.join(here, file).startsWith('..')
          if (outside) {
            Object.assign(child, { tag: 'span', attrs: [['title', `${path.posix.join('docs', here, file)} in the repository`]] })
          } else {
            child.attrSet('href', file.replace(/\.md$/, '.html') + (anchor ? `#${anchor}` : ''))
          }
        } else if (child.type === 'link_close' && outside) {
          child.tag = 'span'
          outside = false
        }
      }
    }
  })
  md.renderer.rules.link_open = open
}

/** Headings have the anchors that GitHub gives them. */
function anchors(md) {
  md.core.ruler.push('anchors', state => {
    const slug = slugs()
    state.tokens.forEach((token, i) => {
      if (token.type === 'heading_open') token.attrSet('id', slug(state.tokens[i + 1].content))
    })
  })
}

/** Wide tables scroll by themselves; alignment needs no inline style. */
function tables(md) {
  md.renderer.rules.table_open = () => '<div class="table" tabindex="0"><table>\n'
  md.renderer.rules.table_close = () => '</table></div>\n'
  md.core.ruler.push('unstyled', state => {
    for (const token of state.tokens) {
      if (/^t[hd]_open$/.test(token.type)) token.attrs = null
    }
  })
}

export default function (config) {
  config.amendLibrary('md', md => [links, anchors, tables].forEach(plugin => md.use(plugin)))
  config.addPassthroughCopy({ '../../docs/*.{png,svg,csv}': '.', '../../docs/pictures/*.png': 'pictures', '../../docs/tutorials/*.csv': 'tutorials', 'style.css': 'style.css', 'search.js': 'search.js', '../public/mark.svg': 'mark.svg' })
  config.addGlobalData('layout', 'page.njk')
  config.addGlobalData('nav', nav)
  config.addGlobalData('permalink', () => data => `${data.page.filePathStem.replace(/^\//, '')}.html`)
  config.addGlobalData('eleventyComputed', {
    title: data => places.find(place => place.file === data.page.filePathStem.slice(1))?.title ?? 'FLIP',
    here: data => data.page.filePathStem.slice(1),
  })
  config.addFilter('from', (to, here) => relative(here, to))
  // What search.js looks through: each page's title and its words.
  config.on('eleventy.after', ({ results, directories }) => {
    const words = html => html.replace(/^[\s\S]*<main[^>]*>|<\/main>[\s\S]*$/g, '').replace(/<[^>]+>/g, ' ').replace(/&[a-z]+;/g, ' ').replace(/\s+/g, ' ')
    const pages = results.filter(one => one.outputPath.endsWith('.html')).map(one => {
      const file = path.relative(directories.output, one.outputPath)
      return { file, title: places.find(place => `${place.file}.html` === file)?.title ?? 'FLIP', text: words(one.content).slice(0, 60_000) }
    })
    pages.sort((a, b) => (a.file < b.file ? -1 : 1))
    fs.writeFileSync(path.join(directories.output, 'search.json'), JSON.stringify(pages))
  })
  return { dir: { input: '../../docs', output: '../docs-dist', includes: '../web/docs', data: '../web/docs/none' }, markdownTemplateEngine: false, templateFormats: ['md'] }
}
