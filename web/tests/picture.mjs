/** The README's picture: `npm run picture -- http://127.0.0.1:8080` writes docs/page.png from a running service. */
import { fileURLToPath } from 'node:url'
import { openBrowser } from './browser.mjs'

const base = process.argv[2] ?? 'http://127.0.0.1:8080'
const chromium = await openBrowser(base)
const page = await chromium.tab({ viewport: { width: 1400, height: 700 }, colorScheme: 'light' })
await chromium.open(page)
await page.locator('table tbody tr').first().waitFor()
await page.evaluate(() => document.fonts.ready)
const { bottom } = await page.locator('main .sheet').last().evaluate((sheet) => sheet.getBoundingClientRect())
const file = fileURLToPath(new URL('../../docs/page.png', import.meta.url))
await page.screenshot({ path: file, clip: { x: 0, y: 0, width: 1400, height: Math.ceil(bottom) + 20 } })
await chromium.browser.close()
console.log(file)
