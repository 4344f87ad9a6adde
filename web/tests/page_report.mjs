/** How the page does among many: `make page-report` fills a data folder with 100 000 weighings and 10 000 jobs and prints times, sizes and long tasks. */
import { execFileSync } from 'node:child_process'
import { availableParallelism } from 'node:os'
import { fileURLToPath } from 'node:url'
import { openBrowser } from './browser.mjs'
import { startService } from './service.mjs'

const [WEIGHINGS, JOBS, REPEATS] = [process.env.WEIGHINGS ?? 100_000, process.env.JOBS ?? 10_000, process.env.REPEATS ?? 20].map(Number)
const ROWS = fileURLToPath(new URL('page_report_rows.py', import.meta.url))

const service = await startService()
try {
  const job = await service.post('/v1/calibrations', { powder: 'salt', sets: 1, method: 'sequential' })
  await service.finished(job.id)
  const weighing = await service.post('/v1/weighings', { powder: 'salt', target: { value: 5, unit: 'mg' }, tolerance: { lower: 1, upper: 1, unit: 'mg' } }, { 'idempotency-key': 'page-report' })
  while (!(await service.get(`/v1/weighings/${weighing.id}`)).weighing.outcome) await new Promise((resolve) => setTimeout(resolve, 200))
  console.log('stored (weighings, jobs):', execFileSync('python3', [ROWS, service.folder, WEIGHINGS, JOBS]).toString().trim())

  const chromium = await openBrowser(service.url)
  const page = await chromium.tab()
  const network = await page.context().newCDPSession(page)
  await network.send('Network.enable')
  let sent = 0
  network.on('Network.loadingFinished', (e) => (sent += e.encodedDataLength))
  await page.addInitScript(() => {
    globalThis.longTasks = []
    globalThis.listNow = () => [...document.querySelectorAll('main table tbody:not([aria-hidden]), main [role=status], main .note')].map((part) => part.textContent).join()
    new PerformanceObserver((list) => globalThis.longTasks.push(...list.getEntries().map((e) => e.duration))).observe({ type: 'longtask', buffered: true })
  })

  const rows = (path) => page.locator(path === 'jobs' ? 'main table tbody tr' : `main table tbody tr a[href*="#/${path}/"]`)
  const told = (name, values, unit, target = '') => {
    const sorted = [...values].sort((a, b) => a - b)
    const at = (share) => sorted[Math.min(sorted.length - 1, Math.floor(share * sorted.length))].toFixed(0)
    console.log(`| ${name} | ${at(0.5)} | ${at(0.95)} | ${unit} | ${target} |`)
  }
  const timed = async (act) => {
    const began = performance.now()
    await act()
    return performance.now() - began
  }
  /** The list as it stands once nothing of the act before is under way. */
  const settled = async () => {
    for (let before = ''; ; await page.waitForTimeout(150)) {
      const now = await page.evaluate(() => globalThis.listNow())
      if (now === before) return now
      before = now
    }
  }
  /** The list is another one: its first rows, or what it says of its size. */
  const changed = async (path, act) => {
    const before = await settled()
    return timed(async () => {
      await act()
      await page.waitForFunction((before) => globalThis.listNow() !== before, before)
      await rows(path).first().waitFor()
    })
  }

  console.log(`\n${REPEATS} repeats, ${availableParallelism()} processors\n\n| what | median | 95th of 100 | unit | target |\n|---|---|---|---|---|`)
  for (const path of ['weighings', 'jobs']) {
    const [times, sizes] = [[], []]
    for (let k = 0; k < REPEATS; k++) {
      await network.send('Network.clearBrowserCache')
      await page.goto('about:blank')
      sent = 0
      times.push(await timed(async () => {
        await page.goto(`${service.url}/#/${path}`)
        await rows(path).first().waitFor()
      }))
      // The stream of events stays open: the network is never idle.
      await page.waitForTimeout(1500)
      sizes.push(sent / 1000)
    }
    told(`${path}: first view, nothing cached`, times, 'ms')
    told(`${path}: sent in the first seconds`, sizes, 'kB', '<= 150')
    await page.waitForTimeout(6000)
    told(`${path}: fetched ahead for other views, once nothing moves`, [sent / 1000 - sizes.at(-1)], 'kB')
  }

  await chromium.open(page, 'weighings')
  await rows('weighings').first().waitFor()
  const outcome = page.getByLabel('Outcome')
  const [filter, sort, search] = [[], [], []]
  for (let k = 0; k < REPEATS; k++) {
    filter.push(await changed('weighings', () => outcome.selectOption('over')))
    filter.push(await changed('weighings', () => outcome.selectOption('')))
  }
  told('weighings: a filter set or taken away', filter, 'ms', '<= 100 by the service')
  const header = page.locator('main table thead').getByRole('button', { name: /^Error/ })
  for (let k = 0; k < REPEATS; k++) sort.push(await changed('weighings', () => header.click()))
  told('weighings: sorted by error, and back', sort, 'ms')
  for (let k = 0; k < REPEATS; k++) search.push(await changed('weighings', async () => {
    await page.getByLabel('Search').fill(`V${777 + k}`)
    await page.keyboard.press('Enter')
  }))
  told('weighings: searched for a vial', search, 'ms')

  await chromium.open(page, 'weighings')
  for (let k = 0; k < 19; k++) await changed('weighings', () => page.getByRole('button', { name: 'Show more' }).click())
  const shown = parseInt((await page.locator('main .note').textContent()).replaceAll('\u2009', ''))
  const drawn = await rows('weighings').count()
  await page.evaluate(() => (globalThis.longTasks.length = 0))
  await page.getByRole('region', { name: 'Weighings', exact: true }).hover()
  for (let k = 0; k < 300; k++) await page.mouse.wheel(0, 400)
  await page.waitForTimeout(500)
  const long = await page.evaluate(() => globalThis.longTasks)
  told(`weighings: longest task while ${shown} rows are scrolled, ${drawn} of them drawn`, [Math.max(0, ...long)], 'ms', '<= 50')
  await chromium.browser.close()

  // Straight at the service, and no browser beside it that takes its time. Every repeat asks for another value.
  const ago = (share) => new Date(Date.now() - share * WEIGHINGS * 60_000).toISOString()
  const FILTERS = {
    powder: (k) => ({ powder: ['salt', 'sand', 'sugar', 'semolina'][k % 4] }),
    outcome: (k) => ({ outcome: ['over', 'under', 'within'][k % 3] }),
    text: (k) => ({ q: `V${777 + k}` }),
    dates: (k) => ({ since: ago((k + 1) / REPEATS), until: ago(0) }),
    lot: (k) => ({ lot: `L${k % 50}` }),
  }
  for (const [name, filter] of Object.entries(FILTERS)) {
    const times = []
    for (let k = 0; k < REPEATS; k++) times.push(await timed(async () => {
      const query = new URLSearchParams({ ...filter(k), limit: 50 })
      const response = await fetch(`${service.own}/v1/weighings?${query}`, { headers: { authorization: `Bearer ${service.token}` } })
      const { total } = await response.json()
      if (!(total > 0)) throw new Error(`${query} finds nothing: ${response.status}`)
    }))
    told(`the service alone: weighings by ${name}`, times, 'ms', '<= 100')
  }
  if (chromium.complaints.length > 0) throw new Error(chromium.complaints.join('\n'))
} finally {
  await service.stop()
}
