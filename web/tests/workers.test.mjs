/** The processes that compute jobs, below the list of jobs: one line for a server alone, a table for several. */
import assert from 'node:assert/strict'
import { execFileSync } from 'node:child_process'
import { join } from 'node:path'
import { after, before, describe, it } from 'node:test'
import { accessibilityFaults, becomes, csvAsShown, fits, holds, openBrowser, picture } from './browser.mjs'
import { startService } from './service.mjs'
import { explanations, unexplained } from './words.mjs'

const SIZES = [[1440, 900], [1280, 800], [390, 844]]
const LOST = 'lost: its jobs go on elsewhere'
const ALL = ['calibration', 'training', 'evaluation', 'investigation', 'repose', 'film']
const HOUR = 3_600_000
let service, chromium, page, own

/** Runs statements on the service's database, each with its values. */
function store(...statements) {
  const script = 'import json, sqlite3, sys\nstore = sqlite3.connect(sys.argv[1], timeout=60)\nfor sql, values in json.load(sys.stdin): store.execute(sql, values)\nstore.commit()'
  execFileSync('python3', ['-c', script, join(service.folder, 'flip.db')], { input: JSON.stringify(statements) })
}
/** A worker heard of so many ms ago; `ended` if it said that it ends then. */
const worker = (name, { kinds = ALL.filter((kind) => kind !== 'repose'), threads = 8, serves = 0, ago = 0, ended = false, now = Date.now() } = {}) => [
  'INSERT INTO worker (id, name, version, kinds, threads, serves, started_at, heard_at, ended_at) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)',
  [`flip-${name}`, name, '0.1.0', JSON.stringify(kinds), threads, serves, now - ago - HOUR, now - ago, ended ? now - ago : null],
]
const main = () => page.getByRole('main')
const table = () => main().getByRole('table', { name: 'Workers', exact: true })
const row = (name) => table().getByRole('row').filter({ has: page.getByRole('rowheader', { name }) })
const names = async () => (await table().getByRole('rowheader').allTextContents()).map((text) => text.trim())
const cells = async (name) => (await row(name).getByRole('cell').allTextContents()).map((text) => text.trim())
const colour = (name) => row(name).getByRole('rowheader').evaluate((it) => getComputedStyle(it).color)
async function open(width, height) {
  await page.setViewportSize({ width, height })
  await chromium.open(page, 'jobs')
}
async function sound(width) {
  for (const scheme of ['light', 'dark']) {
    await page.emulateMedia({ colorScheme: scheme })
    assert.ok(await fits(page), `wider than ${width} px`)
    assert.deepEqual(await accessibilityFaults(page), [], scheme)
  }
}

before(async () => {
  service = await startService()
  own = (await service.get('/v1/workers'))[0]
  chromium = await openBrowser(service.url)
  page = await chromium.tab()
}, { timeout: 60_000 })

after(async () => {
  await chromium?.browser.close()
  await service?.stop()
  assert.deepEqual(chromium?.complaints ?? [], [])
})

describe('a server that computes alone', () => {
  const line = () => `This server computes, on ${own.threads === 1 ? 'one thread' : `${own.threads} threads`}.`

  for (const [width, height] of SIZES) {
    it(`says so in one line, at ${width} px`, async () => {
      await open(width, height)
      await main().getByText(line(), { exact: true }).waitFor()
      assert.equal(await table().count(), 0)
      await sound(width)
    })
  }

  it('says the same after it was started again', async () => {
    store(worker('earlier', { serves: 1, kinds: ALL, ago: HOUR, ended: true }), worker('killed', { serves: 1, kinds: ALL, ago: 2 * HOUR }))
    assert.equal((await service.get('/v1/workers')).length, 3)
    await open(1440, 900)
    await main().getByText(line(), { exact: true }).waitFor()
    assert.equal(await table().count(), 0)
    store(["DELETE FROM worker WHERE id IN ('flip-earlier', 'flip-killed')", []])
  })

  it('says it in the language of the reader', async () => {
    for (const [locale, text] of [['de-DE', /^Dieser Server rechnet, auf/], ['ja-JP', /^このサーバーが \d+ スレッドで計算します。$/]]) {
      const other = await chromium.tab({ locale })
      await chromium.open(other, 'jobs')
      const said = other.getByRole('main').getByText(text)
      await said.waitFor()
      assert.equal(await said.evaluate((it) => it.closest('[lang]').lang), locale.slice(0, 2))
      await other.context().close()
    }
  })
})

describe('several workers', () => {
  const made = []

  before(async () => {
    const long = (powder) => service.post('/v1/calibrations', { powder, method: 'sequential', sets: 12, tolerance_deg: 0.1, trials_max: 400, particles: 1600 })
    for (const powder of ['sand', 'sugar']) made.push((await long(powder)).id)
    await holds(async () => assert.equal((await service.get(`/v1/jobs/${made[0]}`)).state, 'running'))
    const now = Date.now()
    store(
      worker('bench-pc', { ago: 5000, now: now + HOUR }),
      worker('old workstation', { kinds: ['training', 'film'], threads: 1, ago: 0, now: now + HOUR }),
      worker('gone', { ago: 2 * HOUR, ended: true }),
      worker('silent', { ago: 45_000, threads: 4 }),
      // A name that cannot be broken between words, and is as long as may be.
      worker('n'.repeat(100), { kinds: ['film'], now: now + HOUR }),
      worker('gone for long', { ago: 25 * HOUR, ended: true }),
      worker('silent for long', { ago: 25 * HOUR }),
      // The other worker has taken the job that waited.
      ["UPDATE job SET state = 'running', owner = 'flip-bench-pc', lease_until = ?, attempts = 1, started_at = ? WHERE id = ?", [now + 24 * HOUR, now, made[1]]],
    )
  })

  for (const [width, height] of SIZES) {
    it(`are listed, at ${width} px`, async () => {
      // Those that are there have been heard of just now.
      const now = Date.now()
      store(["UPDATE worker SET heard_at = ? WHERE id IN ('flip-bench-pc', 'flip-old workstation') OR id LIKE 'flip-nn%'", [now]], ["UPDATE worker SET heard_at = ? WHERE id = 'flip-silent'", [now - 45_000]])
      await open(width, height)
      await holds(async () => assert.deepEqual((await names()).sort(), [`${own.name} (serves the page)`, 'bench-pc', 'gone', 'n'.repeat(100), 'old workstation', 'silent'].sort()))
      const shown = await table().getByRole('columnheader').allTextContents()
      assert.deepEqual(shown.map((text) => text.trim()), ['Worker', 'Threads', 'Takes', 'Computes now', 'Last heard of'])
      assert.deepEqual((await cells('bench-pc')).slice(0, 3), ['8', 'Calibration, Training, Evaluation, Investigation, Film', 'Calibration, Sugar'])
      assert.deepEqual((await cells('old workstation')).slice(0, 3), ['1', 'Training, Film', '–'])
      assert.deepEqual((await cells('serves the page')).slice(0, 3), [String(own.threads), 'all kinds', 'Calibration, Sand'])
      assert.equal((await cells('gone'))[2], 'ended')
      assert.equal((await cells('silent'))[2], LOST)
      assert.equal(Date.parse(await row('bench-pc').locator('time').getAttribute('datetime')), now)
      const muted = await main().locator('.page-head p').evaluate((it) => getComputedStyle(it).color)
      assert.equal(await colour('gone'), muted)
      for (const name of ['bench-pc', 'silent']) assert.notEqual(await colour(name), muted, name)
      assert.deepEqual(await unexplained(page), [])
      await sound(width)
      await picture(page, `workers-${width}`)
      await page.emulateMedia({ colorScheme: 'light' })
      await picture(page, `workers-${width}-light`)
    })
  }

  it('are in the file as in the table, and their columns explained', async () => {
    await open(1280, 800)
    await row('bench-pc').waitFor()
    const rows = await csvAsShown(page, 'Workers')
    assert.equal(rows.length, 7)
    assert.ok(rows.some(([name, , , computes]) => name === 'silent' && computes === LOST))
    // A list that is read again meanwhile closes what was open.
    await becomes(async () => {
      const said = await explanations(page)
      return ['Worker', 'Takes', 'Last heard of'].filter((word) => !(said.get(word)?.text.length > 12 && said.get(word).within))
    }, [])
    const region = main().getByRole('region', { name: 'Workers', exact: true })
    assert.ok(await region.evaluate((it) => it.scrollWidth <= it.clientWidth + 2), 'every column is shown at 1280 px')
  })

  it('link to what they compute', async () => {
    for (const [name, id] of [['serves the page', made[0]], ['bench-pc', made[1]]]) {
      await open(1440, 900)
      await row(name).getByRole('link', { name: /^Calibration, / }).click()
      await page.waitForURL(new RegExp(`#/calibrations/${id}$`))
      await page.getByRole('heading', { level: 1, name: /Calibration/ }).waitFor()
    }
  })

  it('are in the language of the reader', async () => {
    const other = await chromium.tab({ locale: 'de-DE' })
    await chromium.open(other, 'jobs')
    const german = other.getByRole('table', { name: 'Rechenprozesse', exact: true })
    await german.getByText('verloren: seine Aufträge laufen anderswo weiter').waitFor()
    await german.getByRole('link', { name: /^Kalibrierung, / }).first().waitFor()
    await becomes(async () => (await german.getByRole('columnheader').allTextContents()).map((text) => text.trim()), ['Rechenprozess', 'Threads', 'Übernimmt', 'Rechnet gerade', 'Zuletzt gemeldet'])
    assert.deepEqual(await accessibilityFaults(other), [])
    await other.context().close()
  })

  it('change as jobs do, at once, and as nobody says within 10 s', async () => {
    await open(1440, 900)
    await row('serves the page').getByRole('link').waitFor()
    const asked = () => page.waitForResponse((response) => response.url().endsWith('/v1/workers'), { timeout: 15_000 })
    const told = asked()
    await service.post(`/v1/jobs/${made[0]}/cancel`)
    await told
    await becomes(async () => (await cells('serves the page'))[2], '–')
    store(["UPDATE worker SET ended_at = heard_at WHERE id = 'flip-silent'", []])
    await holds(async () => assert.equal((await cells('silent'))[2], 'ended'))
    await asked()
    await asked()
  })

  it('are one line again once the others are forgotten', async () => {
    store(["DELETE FROM worker WHERE serves = 0", []])
    await main().getByText(/^This server computes, on/).waitFor()
    assert.equal(await table().count(), 0)
  })
})
