/** Jobs on a graphics card: a choice where a process has one, and what is said of those computed there. The card is a row of the database. */
import assert from 'node:assert/strict'
import { execFileSync } from 'node:child_process'
import { join } from 'node:path'
import { after, before, describe, it } from 'node:test'
import { accessibilityFaults, fits, openBrowser, openPanel, unlock } from './browser.mjs'
import { startService } from './service.mjs'

const CARD = 'NVIDIA H200, compute capability 9.0'
const FORMS = [
  ['powders/sand', 'Calibrate', /heaps have the statistics of the processor/],
  ['trainings', 'Start a training', /gives another policy there/],
]
let service, chromium, page

/** A worker that has just been heard of, with a card or without. */
function worker(name, card, ago_ms = 0) {
  const heard = Date.now() - ago_ms
  const values = [`flip-${name}`, name, '0.1.0', JSON.stringify(['calibration', 'training', 'evaluation']), 8, 0, heard - 1000, heard, card]
  const script = 'import json, sqlite3, sys\nstore = sqlite3.connect(sys.argv[1], timeout=60)\nstore.execute("INSERT OR REPLACE INTO worker (id, name, version, kinds, threads, serves, started_at, heard_at, card) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)", json.load(sys.stdin))\nstore.commit()'
  execFileSync('python3', ['-c', script, join(service.folder, 'flip.db')], { input: JSON.stringify(values) })
}
async function panelOf(path, button) {
  await chromium.open(page, path)
  return openPanel(page, button)
}
const choice = (panel) => panel.getByLabel('Compute on')

before(async () => {
  service = await startService()
  chromium = await openBrowser(service.url)
  page = await chromium.tab()
  await chromium.open(page, 'powders')
  await unlock(page, service.token)
}, { timeout: 120_000 })

after(async () => {
  await chromium?.browser.close()
  await service?.stop()
  assert.deepEqual(chromium?.complaints ?? [], [])
})

describe('without a card', () => {
  it('no form asks what to compute on, nor while the one with a card is lost', async () => {
    worker('gone', CARD, 60_000)
    for (const [path, button] of FORMS) {
      const asked = page.waitForResponse('**/v1/workers').then((answer) => answer.finished())
      const panel = await panelOf(path, button)
      await asked
      await panel.getByLabel('Seed').waitFor()
      assert.equal(await choice(panel).count(), 0, path)
    }
  })
})

describe('with a card on another machine', () => {
  it('its name is in the list of those that compute', async () => {
    worker('node-7', CARD)
    await chromium.open(page, 'jobs')
    const table = page.getByRole('main').getByRole('table', { name: 'Workers', exact: true })
    const row = table.getByRole('row').filter({ has: page.getByRole('rowheader', { name: 'node-7' }) })
    await row.getByRole('cell', { name: CARD, exact: true }).waitFor()
  })

  for (const [path, button, hint] of FORMS) {
    it(`${path}: the form offers it, and says what is different there`, async () => {
      worker('node-7', CARD)
      const panel = await panelOf(path, button)
      await choice(panel).waitFor()
      assert.equal(await choice(panel).inputValue(), 'cpu')
      assert.equal(await panel.getByText(hint).count(), 0)
      await choice(panel).selectOption({ label: `Graphics card (${CARD})` })
      await panel.getByText(hint).waitFor()
      assert.ok(await fits(page))
      assert.deepEqual(await accessibilityFaults(page), [])
    })
  }

  it('a request that is refused says so beside the choice', async () => {
    worker('node-7', CARD)
    const panel = await panelOf('powders/sand', 'Calibrate')
    await choice(panel).selectOption('cuda')
    await panel.getByRole('button', { name: 'Start the calibration' }).click()
    // A service with a file as its database has no workers elsewhere, whatever the file says.
    await panel.getByText(/^no graphics card can be used/).waitFor()
    assert.equal(await choice(panel).getAttribute('aria-invalid'), 'true')
  })

  it('a calibration that a card failed says where it was computed, and starts again on the processor', async () => {
    const { id } = await service.post('/v1/calibrations', { powder: 'sand', method: 'sequential', particles: 400 })
    await service.post(`/v1/jobs/${id}/cancel`)
    let found
    for (let k = 0; found?.job.state !== 'cancelled'; k++) {
      assert.ok(k < 100, 'it is not cancelled')
      await new Promise((resolve) => setTimeout(resolve, 100))
      found = await service.get(`/v1/calibrations/${id}`)
    }
    const job = { ...found.job, state: 'failed', error: 'the card was taken away', subject: { ...found.job.subject, device: 'cuda' } }
    await page.route(`**/v1/calibrations/${id}`, (route) => route.fulfill({ json: { ...found, device: 'cuda', job } }))
    await chromium.open(page, `calibrations/${id}`)
    const fact = page.getByRole('definition').filter({ hasText: /^a graphics card$/ })
    await fact.waitFor()
    const asked = page.waitForRequest(`**/v1/jobs/${id}/again?device=cpu`)
    await page.getByRole('button', { name: 'Start again on the processor', exact: true }).click()
    await asked
    await page.getByText('starts an earlier one again').waitFor()
    assert.equal(await fact.count(), 0)
    assert.equal(await page.getByRole('button', { name: 'Start again on the processor' }).count(), 0)
    const jobs = (await service.get('/v1/jobs?kind=calibration')).items
    await service.post(`/v1/jobs/${jobs.find((it) => it.again_of === id).id}/cancel`)
  })
})
