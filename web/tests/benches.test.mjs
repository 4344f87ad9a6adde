/** The benches of all servers, on the page of the bench: nothing for one, a table with a stop for each for several. */
import assert from 'node:assert/strict'
import { execFileSync } from 'node:child_process'
import { join } from 'node:path'
import { after, before, describe, it } from 'node:test'
import { accessibilityFaults, becomes, csvAsShown, fits, openBrowser, picture, unlock } from './browser.mjs'
import { startService } from './service.mjs'
import { unexplained } from './words.mjs'

const SIZES = [[1440, 900], [1280, 800], [390, 844]]
let service, chromium, page

/** Runs statements on the service's database, each with its values. */
function store(...statements) {
  const script = 'import json, sqlite3, sys\nstore = sqlite3.connect(sys.argv[1], timeout=60)\nfor sql, values in json.load(sys.stdin): store.execute(sql, values)\nstore.commit()'
  execFileSync('python3', ['-c', script, join(service.folder, 'flip.db')], { input: JSON.stringify(statements) })
}
/** A bench of another server, last heard of so many ms ago. */
const bench = (name, chain, { ago = 0, powder = null, lot = null } = {}) => [
  'INSERT INTO bench (name, chain, kind, owner, machine, fence, lease_until, since, powder, lot, loaded_at) VALUES (?, ?, ?, ?, ?, 1, ?, ?, ?, ?, ?)',
  [name, chain, 'devices', `flip-${name}`, 'bench-pc', Date.now() + 3_600_000 - ago, Date.now(), powder, lot, powder && Date.now()],
]
const main = () => page.getByRole('main')
const table = () => main().getByRole('table', { name: 'Benches', exact: true })
const row = (name) => table().getByRole('row').filter({ has: page.getByRole('rowheader', { name, exact: true }) })
const cells = async (name) => (await row(name).getByRole('cell').allTextContents()).map((text) => text.trim())
const open = async (width, height) => {
  await page.setViewportSize({ width, height })
  await chromium.open(page, 'bench')
}

before(async () => {
  service = await startService()
  chromium = await openBrowser(service.url)
  page = await chromium.tab()
  await chromium.open(page, 'bench')
  await unlock(page, service.token)
}, { timeout: 60_000 })

after(async () => {
  await chromium?.browser.close()
  await service?.stop()
})

describe('the list of benches', () => {
  it('is not there where there is one', async () => {
    const told = page.waitForResponse((response) => response.url().endsWith('/v1/benches'))
    await open(1440, 900)
    await told
    await main().getByRole('heading', { level: 1, name: 'Bench', exact: true }).waitFor()
    assert.equal(await table().count(), 0)
  })

  for (const [width, height] of SIZES) {
    it(`says of each how it stands and what it holds, at ${width} px`, async () => {
      store(['DELETE FROM bench WHERE chain > 0', []], bench('hall-2', 1, { powder: 'salt', lot: 'L7' }), bench('hall-3', 2, { ago: 7_200_000 }))
      await open(width, height)
      await becomes(async () => (await cells('hall-2')).slice(0, 4), ['Ready', 'Salt, lot L7', '0', 'bench-pc'])
      await becomes(async () => (await cells('hall-3')).slice(0, 4), ['Not served', '–', '0', '–'])
      assert.equal(await row('hall-3').getByRole('button').count(), 0)
      assert.deepEqual(await unexplained(page), [])
      for (const colorScheme of ['light', 'dark']) {
        await page.emulateMedia({ colorScheme })
        assert.ok(await fits(page), `wider than ${width} px`)
        assert.deepEqual(await accessibilityFaults(page), [], colorScheme)
      }
      await picture(page, `benches-${width}`)
    })
  }

  it('is in the file as in the table', async () => {
    await open(1280, 800)
    await row('hall-2').waitFor()
    const rows = await csvAsShown(page, 'Benches')
    assert.ok(rows.some(([name, state, holds]) => name === 'hall-2' && state === 'Ready' && holds === 'Salt, lot L7'))
  })

  it('stops the bench of this server, by the keyboard, and says so when another one does not answer', async () => {
    await open(1440, 900)
    await row('bench').getByRole('button', { name: 'Stop', exact: true }).focus()
    await page.keyboard.press('Enter')
    await row('bench').getByText(/^Stopped after \d+ ms$/).waitFor()
    assert.ok((await service.get('/v1/bench')).held, 'nothing starts after a stop')
    await becomes(async () => (await cells('bench'))[0], 'Held')
    await row('hall-2').getByRole('button', { name: 'Stop', exact: true }).click()
    await row('hall-2').getByRole('alert').getByText('NOT sent: use the wired stop.').waitFor()
    // The list is read again, and what was said stays.
    store(["UPDATE bench SET lot = 'L8' WHERE name = 'hall-2'", []])
    await becomes(async () => (await cells('hall-2'))[1], 'Salt, lot L8')
    assert.ok(await row('hall-2').getByRole('alert').isVisible())
  })

  it('is in the language of the reader', async () => {
    for (const [locale, caption, state] of [['de-DE', 'Wägeplätze', 'Ohne Server'], ['ja-JP', '秤量装置の一覧', 'サーバーなし']]) {
      const other = await chromium.tab({ locale })
      await chromium.open(other, 'bench')
      await other.getByRole('table', { name: caption, exact: true }).getByText(state).waitFor()
      await other.context().close()
    }
  })
})
