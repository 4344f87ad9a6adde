import { svelte } from '@sveltejs/vite-plugin-svelte'
import { readdirSync, readFileSync, writeFileSync } from 'node:fs'
import { join } from 'node:path'
import { brotliCompressSync, constants } from 'node:zlib'
import { defineConfig } from 'vite'
import { languageOf, texts } from './texts.js'

/** Names the files that are fetched after the first view, the second file and those of the languages, so that src/chunk.ts can fetch them in a way that gives way to a stop. */
const later = {
  name: 'flip-later',
  transformIndexHtml: {
    order: 'post',
    handler(_, { bundle = {} }) {
      const named = {}
      for (const chunk of Object.values(bundle).filter((file) => file.type === 'chunk' && !file.isEntry)) (named[languageOf(chunk) ?? 'later'] ??= []).push(`/${chunk.fileName}`)
      return Object.entries(named).map(([name, files]) => ({ tag: 'meta', attrs: { name: `flip-${name}`, content: files.sort().join(' ') }, injectTo: 'head' }))
    },
  },
}

/** A Brotli copy beside every text file, for the service to send: compressed once and harder than it could on the fly. */
const packed = {
  name: 'flip-packed',
  apply: 'build',
  writeBundle({ dir }) {
    for (const name of readdirSync(dir, { recursive: true })) {
      if (!/\.(js|css|html)$/.test(name)) continue
      const bytes = readFileSync(join(dir, name))
      writeFileSync(join(dir, `${name}.br`), brotliCompressSync(bytes, { params: { [constants.BROTLI_PARAM_SIZE_HINT]: bytes.length } }))
    }
  },
}

export default defineConfig({
  plugins: [svelte(), texts, later, packed],
  build: {
    target: 'es2022',
    // The page runs under `default-src 'self'`: nothing may become a data: URI or an inline script.
    assetsInlineLimit: 0,
    modulePreload: { polyfill: false },
    // One style sheet: a second would be fetched by an import, which cannot be called off.
    cssCodeSplit: false,
  },
  // `npm run dev` beside a running `flip serve`.
  server: { proxy: { '/v1': 'http://127.0.0.1:8080' } },
})
