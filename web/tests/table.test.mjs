/** Long lists: rows in view alone are drawn, columns and views are chosen and kept, the place stays; and how light the first view is. */
import assert from 'node:assert/strict'
import { execFileSync } from 'node:child_process'
import { after, before, describe, it } from 'node:test'
import { fileURLToPath } from 'node:url'
import { createServer } from 'vite'
import { accessibilityFaults, becomes, csvOf, fits, holds, openBrowser, picture, tableCells } from './browser.mjs'
import { startFront } from './front.mjs'
import { startService } from './service.mjs'

const WEIGHINGS = 3000
const WIDTHS = [1440, 1280, 390]
let service, chromium, page, policy

before(async () => {
  service = await startService()
  const { id } = await service.post('/v1/calibrations', { powder: 'sand', method: 'sequential', sets: 1, tolerance_deg: 5, trials_max: 60, particles: 400 })
  await service.finished(id)
  policy = (await weigh('first')).policy
  execFileSync('python3', [fileURLToPath(new URL('page_report_rows.py', import.meta.url)), service.folder, String(WEIGHINGS), '300'])
  chromium = await openBrowser(service.url)
  page = await chromium.tab()
}, { timeout: 900_000 })

after(async () => {
  await chromium?.browser.close()
  await service?.stop()
})

/** A dose that has ended. */
async function weigh(key) {
  const { id } = await service.post('/v1/weighings', { powder: 'sand', target: { value: 5, unit: 'mg' }, tolerance: { lower: 1, upper: 1, unit: 'mg' }, policy }, { 'idempotency-key': key })
  for (;;) {
    const { weighing } = await service.get(`/v1/weighings/${id}`)
    if (weighing.outcome) return weighing
    await new Promise((done) => setTimeout(done, 200))
  }
}

const table = (on = page, caption = 'Weighings') => on.getByRole('table', { name: caption, exact: true })
const region = (on = page, caption = 'Weighings') => on.getByRole('region', { name: caption, exact: true })
/** What of the table is drawn, and what of it is seen. */
const seen = (on = page, caption = 'Weighings') =>
  region(on, caption).evaluate((box) => {
    const table = box.querySelector('table')
    const rows = [...table.querySelectorAll('tr[data-key]')]
    const { bottom: head } = table.tHead.rows[0].cells[0].getBoundingClientRect()
    const { bottom } = box.getBoundingClientRect()
    const inside = rows.filter((row) => row.getBoundingClientRect().bottom > head + 1 && row.getBoundingClientRect().top < bottom - 1)
    return {
      drawn: rows.length,
      indices: rows.map((row) => Number(row.getAttribute('aria-rowindex'))),
      count: Number(table.getAttribute('aria-rowcount')),
      first: inside[0]?.dataset.key,
      offset: inside[0] ? inside[0].getBoundingClientRect().top - head : undefined,
      /** No emptiness where rows should be. */
      filled: inside.length > 0 && inside[0].getBoundingClientRect().top <= head + 1 && (inside.at(-1).getBoundingClientRect().bottom >= bottom - 20 || rows.at(-1) === inside.at(-1)),
      widths: [...table.tHead.rows[0].cells].map((cell) => cell.getBoundingClientRect().width),
      top: box.scrollTop,
    }
  })
const frame = (on = page) => on.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))))
async function scrollTo(top, on = page, caption = 'Weighings') {
  await region(on, caption).evaluate((box, top) => (box.scrollTop = top), top)
  await frame(on)
}
/** The list with so many rows loaded. */
async function listed(rows, { on = page, hash = 'weighings', width = 1440 } = {}) {
  await on.setViewportSize({ width, height: 900 })
  await chromium.open(on, hash)
  await table(on).locator('tr[data-key]').first().waitFor()
  for (let loaded = 50; loaded < rows; loaded += 200) {
    await on.getByRole('button', { name: 'Show more' }).click()
    const now = String(loaded + 200).replace(/(?=\d{3}$)/, '\\s?')
    await on.getByText(new RegExp(`^${now} rows\\.`)).waitFor()
    await frame(on)
  }
}
const settled = (what) => page.waitForFunction(([caption, what]) => [...document.querySelectorAll('main [role=status]')].some((status) => status.textContent.includes(what)), ['Weighings', what])

describe('which rows are drawn', () => {
  it('are those that a viewport touches, and a bounded number more, whatever their heights', async () => {
    const vite = await createServer({ root: fileURLToPath(new URL('..', import.meta.url)), server: { middlewareMode: true, ws: false, watch: null }, appType: 'custom', logLevel: 'error' })
    const { drawnRows, rowAt, Rows } = await vite.ssrLoadModule('/src/rows.ts')
    let state = 1
    const random = () => (state = (state * 48271) % 2147483647) / 2147483647
    for (let round = 0; round < 200; round++) {
      const keys = Array.from({ length: Math.floor(300 * random()) }, (_, k) => `row-${k}`)
      const rows = new Rows()
      const real = new Map(keys.map((key) => [key, 20 + Math.floor(60 * random())]))
      rows.measured([...real])
      const tops = rows.tops(keys)
      // The same sums, one by one.
      let y = 0
      const spans = keys.map((key) => [y, (y += real.get(key))])
      assert.equal(tops.at(-1), y)
      const [top, height] = [random() * y, 100 + 800 * random()]
      const [from, to] = drawnRows(tops, top, height)
      const touched = spans.flatMap(([a, b], k) => (b > top && a < top + height ? [k] : []))
      assert.ok(touched.every((k) => k >= from && k < to), `${touched} in ${from} to ${to}`)
      assert.ok(to - from <= touched.length + 32 && from >= 0 && to <= keys.length)
      if (keys.length > 0) assert.ok(spans[rowAt(tops, top)][0] <= top && top <= spans[rowAt(tops, top)][1])
    }
    const rows = new Rows(30)
    assert.deepEqual([...rows.tops(['a', 'b'])], [0, 30, 60])
    assert.equal(rows.measured([['a', 40], ['b', 40]]), true)
    assert.equal(rows.measured([['a', 40], ['b', 40]]), false, 'nothing moves twice')
    assert.deepEqual([...rows.tops(['a', 'b', 'not yet drawn'])], [0, 40, 80, 120])
    await vite.close()
  })

  for (const width of WIDTHS) {
    it(`is a window of thousands, at ${width} px`, async () => {
      await listed(1050, { width })
      const { total } = await service.get('/v1/weighings?limit=1')
      const began = await seen()
      assert.equal(began.count, total + 1)
      for (const top of [700, 5000, 20_000, 34_000, 12_345, 0]) {
        await scrollTo(top)
        const { drawn, indices, filled, widths, first } = await seen()
        assert.ok(drawn <= 80, `${drawn} rows are drawn`)
        assert.ok(filled, `rows are missing at ${top}`)
        assert.deepEqual(indices, indices.map((_, k) => indices[0] + k))
        // Newest first: the first is the real dose, then w003000 and down.
        if (top > 0) assert.equal(first, `w${String(WEIGHINGS - (indices[await table().locator('tr[data-key]').evaluateAll((rows, first) => rows.findIndex((row) => row.dataset.key === first), first)] - 2)).padStart(6, '0')}`)
        assert.deepEqual(widths, began.widths, 'columns stand still')
      }
      assert.ok(await fits(page))
      await scrollTo(5000)
      assert.deepEqual(await accessibilityFaults(page), [])
      await picture(page, `table-${width}`)
    })
  }

  it('can be reached by keys alone, row after row', async () => {
    await listed(250)
    await table().locator('tr[data-key] a').first().focus()
    for (let k = 0; k < 120; k++) await page.keyboard.press('Tab')
    const at = await page.evaluate(() => document.activeElement.closest('tr')?.getAttribute('aria-rowindex'))
    // A box and two links a row: to compare it, its name and its policy.
    assert.equal(at, '42')
    await region().focus()
    await page.keyboard.press('End')
    await page.waitForFunction(() => document.querySelector('table[data-file=weighings] tr[aria-rowindex="251"]'))
    // A row that stays in sight keeps the focus.
    await scrollTo(0)
    const link = table().locator('tr[data-key] th a').nth(19)
    const hash = await link.evaluate((a) => (a.focus(), a.hash))
    for (const top of [600, 300, 680, 0]) {
      await scrollTo(top)
      assert.equal(await page.evaluate(() => document.activeElement.hash), hash, `at ${top}`)
    }
    // The row with the focus goes out of sight: the keys go on where the reader is.
    await scrollTo(0)
    await table().locator('tr[data-key] a').first().focus()
    await scrollTo(6000)
    assert.equal(await page.evaluate(() => document.activeElement.getAttribute('aria-label')), 'Weighings')
    await page.keyboard.press('Home')
    await page.waitForFunction(() => document.querySelector('table[data-file=weighings]').closest('[role=region]').scrollTop === 0)
  })

  it('says what the search of the browser does not find', async () => {
    await page.getByText('250 rows. The browser’s own search finds only those in view; the one above finds all.').waitFor()
  })

  it('is every loaded row on paper', async () => {
    await listed(250)
    await page.evaluate(() => addEventListener('beforeprint', () => (globalThis.onPaper = document.querySelectorAll('table[data-file=weighings] tr[data-key]').length)))
    await page.pdf()
    assert.equal(await page.evaluate(() => globalThis.onPaper), 250)
    await frame()
    assert.ok((await seen()).drawn <= 80)
  })

  it('is a window of jobs too', async () => {
    await chromium.open(page, 'jobs')
    await table(page, 'Jobs').locator('tr[data-key]').first().waitFor()
    await page.getByRole('button', { name: 'Show older' }).click()
    await page.getByText('250 rows.').waitFor()
    await scrollTo(4000, page, 'Jobs')
    const { drawn, filled } = await seen(page, 'Jobs')
    assert.ok(drawn <= 80 && filled, `${drawn}`)
  })
})

describe('the place in a list', () => {
  it('is kept on the way back, by mouse, by key and after a reload', async () => {
    await listed(650)
    await scrollTo(9000)
    await page.evaluate(() => window.scrollTo(0, 200))
    await frame()
    const before = await seen()
    const link = table().locator('tr[data-key] th a').nth(15)
    const row = await link.evaluate((a) => a.closest('tr').dataset.key)
    const came = () =>
      holds(async () => {
        const now = await seen()
        assert.equal(now.first, before.first)
        assert.ok(Math.abs(now.top - before.top) < 2, `${now.top} for ${before.top}`)
        assert.ok(Math.abs(now.offset - before.offset) < 2, `${now.offset} for ${before.offset}`)
        assert.equal(await page.evaluate(() => scrollY), 200)
      })
    await link.evaluate((a) => (a.focus({ preventScroll: true }), a.click()))
    await page.locator('.verdict').waitFor()
    await page.goBack()
    await came()
    await page.waitForFunction((row) => document.activeElement.closest('tr')?.dataset.key === row, row)
    await page.keyboard.press('Enter')
    await page.locator('.verdict').waitFor()
    await page.keyboard.press('Alt+ArrowLeft')
    await page.evaluate(() => location.hash.includes('weighings/') && history.back())
    await came()
    await page.reload()
    await came()
    // A link is another way in: it begins at the top.
    await page.getByRole('link', { name: 'Powders', exact: true }).click()
    await page.getByRole('heading', { name: 'Powders', level: 1 }).waitFor()
    await page.getByRole('link', { name: 'Weighings', exact: true }).click()
    await table().locator('tr[data-key]').first().waitFor()
    assert.equal((await seen()).top, 0)
  })

  it('stays while doses come in, and the top shows the new ones', async () => {
    await listed(250)
    await scrollTo(3000)
    const before = await seen()
    await weigh('comes-in')
    await settled(`${before.count} in all`)
    await holds(async () => {
      const now = await seen()
      assert.equal(now.first, before.first)
      assert.ok(Math.abs(now.offset - before.offset) < 2 && now.top > before.top + 20, JSON.stringify([before, now]))
    })
    await scrollTo(0)
    const dose = await weigh('at-the-top')
    await settled(`${before.count + 1} in all`)
    await page.waitForFunction((key) => document.querySelector('table[data-file=weighings] tr[data-key]')?.dataset.key === key, dose.id)
    assert.equal((await seen()).top, 0)
  })

  it('is the beginning after another question', async () => {
    await listed(250)
    await scrollTo(3000)
    const { total } = await service.get('/v1/weighings?outcome=over&limit=1')
    await page.getByLabel('Outcome').selectOption('over')
    await settled(`${total} match`)
    await frame()
    assert.equal((await seen()).top, 0)
  })
})

describe('columns', () => {
  const heads = (on = page) => table(on).locator('thead th:not(.no-print)').allTextContents()
  it('are chosen by keys, remembered, in the address, and in the CSV', async () => {
    const own = await chromium.tab()
    await listed(50, { on: own, hash: 'weighings?q=v2999' })
    const whole = await heads(own)
    await own.getByRole('button', { name: 'Columns' }).focus()
    await own.keyboard.press('Enter')
    const panel = own.getByRole('dialog', { name: 'Columns shown' })
    await panel.waitFor()
    await becomes(() => own.evaluate(() => document.activeElement.type), 'checkbox')
    await panel.getByRole('checkbox', { name: 'Policy' }).focus()
    await own.keyboard.press('Space')
    await panel.getByRole('checkbox', { name: 'Shakes' }).focus()
    await own.keyboard.press('Space')
    assert.deepEqual(await accessibilityFaults(own), [])
    await own.keyboard.press('Escape')
    await panel.waitFor({ state: 'hidden' })
    await becomes(() => own.evaluate(() => document.activeElement.textContent), `Columns: ${whole.length - 2} of ${whole.length}`)
    const left = whole.filter((name) => !['Policy', 'Shakes'].includes(name))
    await becomes(() => heads(own), left)
    await becomes(() => own.url(), /hidden=policy\.shakes/)
    const { rows } = await csvOf(own, 'Weighings')
    assert.deepEqual(rows, await tableCells(table(own)))
    // Remembered: another way in shows the same, and its address says so.
    await own.getByRole('link', { name: 'Powders', exact: true }).click()
    await own.getByRole('link', { name: 'Weighings', exact: true }).click()
    await own.waitForURL(/hidden=policy\.shakes/)
    await table(own).locator('tr[data-key]').first().waitFor()
    await becomes(() => heads(own), left)
    // Someone else sees all, and by the link the same; all can be had again, here and by a link.
    const other = await chromium.tab()
    await listed(50, { on: other, hash: 'weighings?q=v2999' })
    await becomes(() => heads(other), whole)
    await listed(50, { on: other, hash: 'weighings?q=v2999&hidden=policy.shakes.nonsense' })
    await becomes(() => heads(other), left)
    await own.getByRole('button', { name: /^Columns/ }).click()
    await own.getByRole('button', { name: 'Show all columns' }).click()
    await becomes(() => heads(own), whole)
    await own.reload()
    await table(own).locator('tr[data-key]').first().waitFor()
    await becomes(() => heads(own), whole)
    for (const one of [own, other]) await one.context().close()
  })

  for (const width of WIDTHS) {
    it(`are chosen within the window at ${width} px, in both themes`, async () => {
      for (const scheme of ['light', 'dark']) {
        await page.emulateMedia({ colorScheme: scheme })
        await listed(50, { width })
        await page.getByRole('button', { name: /^Columns/ }).click()
        const { height } = page.viewportSize()
        await holds(async () => {
          const box = await page.getByRole('dialog', { name: 'Columns shown' }).boundingBox()
          assert.ok(box.x >= 0 && box.x + box.width <= width && box.y >= 0 && box.y + box.height <= height, JSON.stringify(box))
        })
        assert.deepEqual(await accessibilityFaults(page), [])
        await picture(page, `table-columns-${width}-${scheme}`)
        await page.keyboard.press('Escape')
      }
      await page.emulateMedia({ colorScheme: 'light' })
    })
  }
})

describe('saved views', () => {
  const views = () => page.getByRole('button', { name: /^Views?\b/ })
  const panel = () => page.getByRole('dialog', { name: 'Saved views' })
  const keep = async (name) => {
    await panel().getByLabel('Keep the present view as').fill(name)
    await page.keyboard.press('Enter')
  }
  const asked = () => new URLSearchParams(new URL(page.url()).hash.split('?')[1] ?? '')

  it('keep filters, order and columns under a name', async () => {
    await listed(50, { hash: 'weighings?outcome=over&sort=error&hidden=policy' })
    await views().focus()
    await page.keyboard.press('Enter')
    await panel().getByText('A view is a name for').waitFor()
    await keep('  ')
    await panel().getByRole('alert').getByText('Give the view a name.').waitFor()
    await keep('Worst overdoses')
    await page.getByRole('button', { name: 'View: Worst overdoses' }).waitFor()
    assert.deepEqual(await accessibilityFaults(page), [])
    await picture(page, 'table-views')
    await page.keyboard.press('Escape')
    await page.getByLabel('Powder').last().selectOption('salt')
    await page.getByRole('button', { name: 'Views', exact: true }).click()
    await keep('worst OVERDOSES')
    await panel().getByRole('alert').getByText('There is a view called “Worst overdoses”.').waitFor()
    await keep('Of salt')
    await panel().getByRole('link', { name: 'Worst overdoses' }).click()
    await panel().waitFor({ state: 'hidden' })
    await becomes(() => Object.fromEntries(asked()), { outcome: 'over', sort: 'error', hidden: 'policy' })
    await settled('match')
    await becomes(() => page.getByLabel('Powder').last().inputValue(), '')
    // They are this browser's: another tab of it has them at once.
    const beside = await chromium.beside(page.context())
    await chromium.open(beside, 'weighings?outcome=over&powder=salt&sort=error&hidden=policy')
    await beside.getByRole('button', { name: 'View: Of salt' }).waitFor()
    await beside.close()
  })

  it('are shared by their link', async () => {
    await page.getByRole('button', { name: 'View: Worst overdoses' }).click()
    const address = await panel().getByRole('link', { name: 'Of salt' }).getAttribute('href')
    const other = await chromium.tab()
    await chromium.open(other, address.replace(/^#\//, ''))
    await table(other).locator('tr[data-key]').first().waitFor()
    await becomes(() => other.getByLabel('Outcome').inputValue(), 'over')
    const cells = await tableCells(table(other))
    assert.ok(!cells[0].includes('Policy') && cells.slice(1).every(([powder, verdict]) => powder === 'Salt' && verdict === 'Over'))
    assert.equal(await table(other).getByRole('columnheader', { name: 'Error (mg)' }).getAttribute('aria-sort'), 'descending')
    await other.context().close()
  })

  it('are renamed and removed by keys', async () => {
    await panel().getByRole('button', { name: 'Rename Of salt' }).press('Enter')
    const name = panel().getByLabel('New name of Of salt')
    await page.waitForFunction(() => document.activeElement.getAttribute('aria-label') === 'New name of Of salt')
    await name.fill('Worst overdoses')
    await name.press('Enter')
    await panel().getByRole('alert').waitFor()
    await becomes(() => name.getAttribute('aria-invalid'), 'true')
    await name.press('Escape')
    await panel().getByRole('link', { name: 'Of salt' }).waitFor()
    await panel().getByRole('button', { name: 'Rename Of salt' }).press('Enter')
    await name.fill('Overdoses of salt')
    await name.press('Enter')
    await panel().getByRole('link', { name: 'Overdoses of salt' }).waitFor()
    await panel().getByRole('button', { name: 'Remove Worst overdoses' }).press('Enter')
    await page.reload()
    await page.getByRole('button', { name: 'Views', exact: true }).click()
    await becomes(() => panel().getByRole('link').allTextContents(), ['Overdoses of salt'])
  })

  it('survive what a browser may hold in their place', async () => {
    const kept = ['nonsense', '{"a":1}', '[{"name":""},{"name":"Good","query":"outcome=over"},7]']
    for (const text of kept) {
      await page.evaluate((text) => localStorage.setItem('flip-views-weighings', text), text)
      await page.reload()
      await page.getByRole('button', { name: /^Views?\b/ }).click()
      await panel().getByText('Saved views').waitFor()
      await becomes(() => panel().getByRole('link').allTextContents(), text.startsWith('[') ? ['Good'] : [])
    }
    await page.evaluate(() => localStorage.clear())
  })
})

describe('the first view', () => {
  it('is at most 150 kB, all requests together, from this binary', { skip: process.env.FLIP_PAGE && 'the page is not served by the binary' }, async () => {
    for (const view of ['weighings', 'jobs', '']) {
      const own = await chromium.tab()
      const network = await own.context().newCDPSession(own)
      await network.send('Network.enable')
      let sent = 0
      network.on('Network.loadingFinished', (e) => (sent += e.encodedDataLength))
      await chromium.open(own, view)
      await own.waitForTimeout(1500)
      await holds(() => assert.ok(sent > 50_000))
      assert.ok( sent <= 150_000, `${view}: ${sent} bytes`)
      await own.context().close()
    }
  })

  it('is followed by the rest only when the page is quiet, and never while something moves', async () => {
    const bench = await service.get('/v1/bench')
    let moving = 'a-weighing'
    const front = await startFront(service.url, { folder: process.env.FLIP_PAGE, does: ({ path }) => (path === '/v1/bench' ? { status: 200, body: { ...bench, moving } } : undefined) })
    const rest = () => front.seen.filter(({ path }) => path.startsWith('/assets/later')).length
    const own = await chromium.beside(await chromium.browser.newContext())
    await own.goto(`${front.url}/#/weighings`)
    await own.getByRole('button', { name: 'Stop', exact: true }).waitFor()
    await own.waitForTimeout(6000)
    assert.equal(rest(), 0, 'nothing is fetched ahead while something moves')
    moving = null
    const came = own.waitForResponse('**/assets/later-*')
    await own.getByText('in all').waitFor()
    await came
    await own.getByRole('link', { name: 'Simulator', exact: true }).click()
    await own.getByRole('heading', { name: 'Simulators', level: 1 }).waitFor()
    // What was read is what is imported: the file is asked for once. A front with a folder keeps nothing.
    if (!process.env.FLIP_PAGE) await becomes(rest, 1)
    await own.context().close()
    await front.stop()
    chromium.complaints.splice(0, chromium.complaints.length, ...chromium.complaints.filter((text) => !text.startsWith(`asked for ${front.url}`)))
  })

  it('complained of nothing', () => assert.deepEqual(chromium.complaints, []))
})
