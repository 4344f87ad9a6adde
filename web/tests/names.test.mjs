/** Names, notes and tags on every view; archives; powders by their names; corrected measurements; the queue. */
import assert from 'node:assert/strict'
import { after, before, describe, it } from 'node:test'
import { accessibilityFaults, becomes, fits, openBrowser, openPanel, picture, unlock } from './browser.mjs'
import { startService } from './service.mjs'

let service, chromium, page

/** Small enough to end at once. */
const quick = (powder, seed = 1) => ({ powder, method: 'sequential', sets: 2, tolerance_deg: 5, trials_max: 60, particles: 400, seed })

before(async () => {
  service = await startService()
  const { id } = await service.post('/v1/calibrations', quick('sand'))
  await service.finished(id)
  const dose = await service.post('/v1/weighings', { powder: 'sand', target: { value: 12, unit: 'mg' }, tolerance: { lower: 2, upper: 2, unit: 'mg' } }, { 'idempotency-key': 'names-1' })
  while (!(await service.get(`/v1/weighings/${dose.id}`)).weighing.outcome) await new Promise((go) => setTimeout(go, 200))
  chromium = await openBrowser(service.url)
  page = await chromium.tab()
}, { timeout: 900_000 })

after(async () => {
  await chromium?.browser.close()
  await service?.stop()
})

const first = async (list) => (await service.get(list)).items[0]
const editor = () => page.getByRole('button', { name: /Name, tag or note|Edit name, tags and note/ })
async function open(address, width = 1440) {
  await page.setViewportSize({ width, height: 900 })
  await chromium.open(page, address)
  if (!(await page.getByRole('button', { name: /Token set/ }).count())) await unlock(page, service.token)
}

describe('names', () => {
  it('are given on the view of each thing, by the keyboard alone, and stand as its heading', async () => {
    const calibration = (await first('/v1/calibrations')).job.id
    const policy = (await first('/v1/policies')).id
    const weighing = (await first('/v1/weighings')).id
    for (const [view, kind, id] of [['calibrations', 'calibration', calibration], ['policies', 'policy', policy], ['weighings', 'weighing', weighing], ['powders', 'powder', 'sand']]) {
      await open(`${view}/${id}`)
      await editor().press('Enter')
      const name = page.getByLabel('Name', { exact: true })
      await name.fill(`Third try, ${kind}`)
      await page.getByLabel('Tags').fill('batch 7, GMP')
      await page.getByLabel('Note').fill('Two lines,\nof what was different.')
      assert.deepEqual(await accessibilityFaults(page), [], view)
      await page.getByLabel('Tags').press('Enter')
      await page.getByRole('heading', { level: 1, name: `Third try, ${kind}` }).waitFor()
      await page.getByText('of what was different.').waitFor()
      const label = await service.get(`/v1/labels/${kind}/${id}`)
      assert.deepEqual([label.name, label.tags, label.note], [`Third try, ${kind}`, ['batch 7', 'GMP'], 'Two lines,\nof what was different.'])
      // The focus is back where it was, and Escape leaves everything as it is.
      await becomes(() => page.evaluate(() => document.activeElement?.textContent), /Edit name/)
      await editor().press('Enter')
      await name.fill('Something else')
      await name.press('Escape')
      await name.waitFor({ state: 'detached' })
      assert.equal((await service.get(`/v1/labels/${kind}/${id}`)).name, `Third try, ${kind}`)
      assert.deepEqual(await accessibilityFaults(page), [], view)
    }
  })

  it('say in the form why one is refused', async () => {
    await open('powders/salt')
    await editor().click()
    await page.getByLabel('Name', { exact: true }).fill('Sugar')
    await page.getByRole('button', { name: 'Save' }).click()
    await page.getByText(/already called/).waitFor()
    assert.deepEqual(await accessibilityFaults(page), [])
    assert.equal((await service.get('/v1/labels/powder/salt')).name, 'Salt')
  })

  it('filter lists by tag, and archives hide until they are shown', async () => {
    await open('policies')
    await page.getByLabel('Tag').selectOption('GMP')
    const table = page.getByRole('region', { name: 'Policies', exact: true })
    await becomes(() => table.getByRole('rowheader').count(), 1)
    await table.getByRole('rowheader', { name: 'Third try, policy' }).waitFor()
    await page.getByLabel('Tag').selectOption('')
    await table.getByRole('rowheader').nth(1).waitFor()
    await open(`policies/${(await first('/v1/policies?tag=GMP')).id}`)
    await editor().click()
    await page.getByRole('button', { name: 'Archive', exact: true }).click()
    await page.getByText(/^Archived/).waitFor()
    await open('policies')
    await page.getByLabel('Archived').waitFor()
    await table.getByRole('rowheader').first().waitFor()
    assert.equal(await table.getByRole('rowheader', { name: 'Third try, policy' }).count(), 0)
    await page.getByLabel('Archived').selectOption('only')
    await table.getByRole('rowheader', { name: 'Third try, policy' }).waitFor()
    assert.deepEqual(await accessibilityFaults(page), [])
  })

  it('fit a phone', async () => {
    for (const address of [`calibrations/${(await first('/v1/calibrations')).job.id}`, 'jobs', 'powders/sand']) {
      await open(address, 390)
      if (address !== 'jobs') await editor().click()
      await page.waitForTimeout(300)
      assert.ok(await fits(page), address)
      assert.deepEqual(await accessibilityFaults(page), [], address)
    }
    await picture(page, 'names-phone')
  })
})

describe('powders', () => {
  it('are called what people call them', async () => {
    for (const name of ['3-Nitrotoluene', 'α-D-Glucose', 'ブドウ糖']) {
      await open('powders')
      const form = await openPanel(page, 'Add a measured powder')
      await form.getByLabel('Name').fill(name)
      await form.getByLabel('Mean (°)').fill('41')
      await form.getByLabel('SD (°)').fill('1')
      await page.getByRole('button', { name: 'Add the measurement' }).click()
      await page.getByRole('rowheader', { name }).waitFor()
    }
    const { items } = await service.get('/v1/powders')
    assert.deepEqual(items.slice(-3).map((p) => p.name), ['3-Nitrotoluene', 'α-D-Glucose', 'ブドウ糖'])
  })

  it('are not left behind by a refused measurement', async () => {
    await open('powders')
    const form = await openPanel(page, 'Add a measured powder')
    await form.getByLabel('Name').fill('Talc')
    await form.getByLabel('Mean (°)').fill('95')
    await form.getByLabel('SD (°)').fill('1')
    await page.getByRole('button', { name: 'Add the measurement' }).click()
    await form.locator('.error').first().waitFor()
    assert.equal((await service.get('/v1/powders')).items.some((p) => p.name === 'Talc'), false)
  })

  it('show a corrected value with its reason', async () => {
    await open('powders/sugar')
    const table = page.getByRole('region', { name: 'Measurements', exact: true })
    await table.getByRole('button', { name: /Correct or withdraw/ }).first().press('Enter')
    const form = page.getByRole('form', { name: /Correct or withdraw/ })
    await form.getByLabel('Mean (°)').fill('33.25')
    await form.getByLabel('Reason').fill('read from the wrong line')
    assert.deepEqual(await accessibilityFaults(page), [])
    await form.getByRole('button', { name: 'Correct' }).press('Enter')
    await table.getByText(/Corrected .* read from the wrong line/).waitFor()
    await table.getByRole('cell', { name: '33.25', exact: true }).waitFor()
    const { measurements, powder } = await service.get('/v1/powders/sugar')
    assert.equal(powder.flowability.repose_deg, 33.25)
    assert.equal(measurements.filter((m) => m.withdrawn).length, 1)
    assert.deepEqual(await accessibilityFaults(page), [])
  })
})

describe('the queue', () => {
  it('says of what each job is and its place, and a cancelled one starts again', async () => {
    const long = (seed) => ({ powder: 'sand', method: 'sequential', sets: 12, tolerance_deg: 0.1, trials_max: 400, particles: 1600, seed })
    const [running, waiting, last] = [await service.post('/v1/calibrations', long(1)), await service.post('/v1/calibrations', { ...long(2), powder: 'sugar' }), await service.post('/v1/calibrations', { ...long(3), powder: 'salt' })]
    await open('jobs')
    const rows = page.getByRole('region', { name: 'Jobs' }).locator('tbody tr')
    await rows.filter({ hasText: 'Sugar' }).getByText('next in the queue').waitFor()
    await rows.filter({ hasText: 'Salt' }).getByText('2nd in the queue').waitFor()
    await rows.filter({ hasText: /Third try.*Running|Sand.*Running/ }).first().waitFor()
    assert.deepEqual(await accessibilityFaults(page), [])
    await picture(page, 'names-jobs')
    await rows.filter({ hasText: 'Sugar' }).getByRole('button', { name: 'Cancel' }).click()
    await rows.filter({ hasText: 'Salt' }).getByText('next in the queue').waitFor()
    await rows.filter({ hasText: 'Sugar' }).getByRole('button', { name: 'Start again' }).press('Enter')
    await page.waitForURL(/#\/calibrations\//)
    await page.getByText('2nd in the queue').waitFor()
    await page.getByRole('link', { name: 'an earlier one' }).waitFor()
    const id = page.url().split('/').at(-1)
    assert.equal((await service.get(`/v1/jobs/${id}`)).again_of, waiting.id)
    for (const job of [id, last.id, running.id]) await service.post(`/v1/jobs/${job}/cancel`)
  })
})
