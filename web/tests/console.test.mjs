/** The home of the page: is it safe, what moves, what waits; the first steps; how one gets about. */
import assert from 'node:assert/strict'
import { after, before, describe, it } from 'node:test'
import { accessibilityFaults, becomes, fits, openBrowser, openPanel, picture, unlock } from './browser.mjs'
import { startService } from './service.mjs'

let service, chromium
const SIZES = [[1440, 900], [1280, 800], [390, 844]]

before(async () => {
  service = await startService()
  chromium = await openBrowser(service.url)
}, { timeout: 60_000 })

after(async () => {
  await chromium?.browser.close()
  await service?.stop()
  assert.deepEqual(chromium?.complaints ?? [], [])
})


describe('a bench of which nothing has been heard yet', () => {
  for (const view of ['', 'wall']) {
    it(`is not called ready, on ${view || 'the console'}`, async () => {
      const page = await chromium.tab()
      let answer
      const asked = new Promise((go) => (answer = go))
      await page.route('**/v1/bench', async (route) => { await asked; await route.continue() })
      await page.goto(`${service.url}/#/${view}`)
      await page.getByRole('heading', { name: 'Loading…', level: 1 }).waitFor()
      assert.equal(await page.getByText(/^Ready$|No doses are waiting|can weigh/).count(), 0)
      answer()
      await page.getByRole('heading', { name: 'Ready', level: 1 }).waitFor()
      await page.close()
    })
  }
})

describe('a first visit', () => {
  it('measures, calibrates and weighs, from the keyboard', async () => {
    const page = await chromium.tab()
    await chromium.open(page)
    await page.getByRole('heading', { name: 'Ready', level: 1 }).waitFor()
    await unlock(page, service.token)
    const steps = page.getByRole('region', { name: 'First steps' })
    await steps.getByText(/Sand piles at 28\.6°/).waitFor()
    assert.ok(await steps.getByRole('button', { name: 'Weigh 15 mg of sand' }).isDisabled())
    assert.deepEqual(await accessibilityFaults(page), [])
    await picture(page, 'first-steps')
    await steps.getByRole('button', { name: 'Calibrate sand' }).focus()
    await page.keyboard.press('Enter')
    const weigh = steps.getByRole('button', { name: 'Weigh 15 mg of sand', disabled: false })
    await weigh.waitFor({ timeout: 180_000 })
    await weigh.press('Enter')
    await page.getByRole('heading', { name: /15\.00 mg of Sand/ }).waitFor()
    await page.locator('.verdict .badge').getByText(/Within|Under|Over/).waitFor({ timeout: 180_000 })
    await chromium.open(page)
    await page.getByRole('table', { name: 'Last doses' }).getByRole('rowheader', { name: 'Sand' }).waitFor()
    // They go once a dose was weighed.
    await becomes(() => steps.count(), 0)
    await page.getByRole('link', { name: 'First steps' }).click()
    await steps.waitFor()
    await page.context().close()
  })
})

describe('the console', () => {
  for (const [width, height] of SIZES) {
    it(`shows what moves, in which phase, for how long, and who is next, at ${width} px`, async () => {
      const page = await chromium.tab({ viewport: { width, height } })
      const [made] = (await service.get('/v1/weighings')).items
      const { weighing, ticks } = await service.get(`/v1/weighings/${made.id}`)
      const bench = { ...(await service.get('/v1/bench')), moving: made.id, waiting: [{ id: '01930000-0000-7000-8000-000000000009', powder: 'sand', target_mg: 8, vial: 'V9', state: 'planned' }] }
      await page.route('**/v1/bench', (route) => route.fulfill({ json: bench }))
      // In the middle of a dose.
      const started_at = new Date(Date.now() - 1000).toISOString()
      await page.route(`**/v1/weighings/${made.id}`, (route) => route.fulfill({ json: { weighing: { ...weighing, state: 'dosing', started_at, finished_at: null, asked: { lot: 'L7', vial: 'V8' } }, ticks } }))
      await page.route('**/v1/weighings?powder=*', (route) => route.fulfill({ json: { items: [{ ...weighing, started_at: '2026-01-02T03:00:00Z', finished_at: '2026-01-02T03:02:00Z' }], next: null, total: 1 } }))
      await chromium.open(page)
      await page.getByRole('heading', { name: 'Moving', level: 1 }).waitFor()
      const dose = page.getByRole('region', { name: 'This dose' })
      await dose.getByText('15.00 mg of Sand, lot L7, vial V8').waitFor()
      await becomes(async () => Number((await dose.locator('.digits').textContent()).replace('−', '-')), ticks.at(-1).reading.mass_mg)
      assert.ok(parseFloat(await dose.locator('.digits').evaluate((it) => getComputedStyle(it).fontSize)) >= 96)
      await becomes(() => dose.locator('[aria-current=step]').textContent(), 'Powder is falling')
      await dose.getByText(/For \d+ s; about 1 min 5\d s left/).waitFor()
      await page.getByRole('list', { name: 'Waiting doses' }).getByText('8.00 mg of Sand, vial V9').waitFor()
      await page.getByRole('button', { name: 'Stop', exact: true }).waitFor()
      assert.ok(await fits(page))
      assert.deepEqual(await accessibilityFaults(page), [])
      await picture(page, `console-moving-${width}`)
      await page.unrouteAll()
      const reason = 'The process ended while the spoon moved: look at spoon and vial.'
      await page.route('**/v1/bench', (route) => route.fulfill({ json: { ...bench, moving: null, latch: { at: '2026-01-02T03:04:05Z', reason, weighing: made.id } } }))
      await chromium.open(page)
      await page.getByRole('heading', { name: 'Latched', level: 1 }).waitFor()
      await page.getByRole('main').getByText(reason).waitFor()
      await page.getByRole('main').getByRole('link', { name: 'Inspect the bench, then clear it' }).waitFor()
      assert.deepEqual(await accessibilityFaults(page), [])
      await picture(page, `console-latched-${width}`)
      await page.context().close()
    })
  }
})

describe('one gets about', () => {
  for (const [width, height] of SIZES) {
    it(`by groups and their places, at ${width} px`, async () => {
      const page = await chromium.tab({ viewport: { width, height } })
      await chromium.open(page)
      const views = page.getByRole('navigation', { name: 'Views' })
      const menu = page.getByRole('button', { name: 'Menu of views' })
      if (width < 640) {
        assert.equal(await views.count(), 0, 'closed')
        await menu.focus()
        await page.keyboard.press('Enter')
        await picture(page, 'menu')
      } else assert.equal(await menu.count(), 0)
      await views.getByRole('link', { name: 'Learn' }).click()
      await page.getByRole('heading', { name: 'Trainings', level: 1 }).waitFor()
      await page.getByRole('navigation', { name: 'Learn' }).getByRole('link', { name: 'Policies' }).click()
      await page.getByRole('heading', { name: 'Policies', level: 1 }).waitFor()
      await becomes(() => page.title(), /^Policies · FLIP$/)
      // A word of the field, by touch or keyboard.
      await page.getByRole('button', { name: 'What is meant by policy?' }).first().focus()
      await page.keyboard.press('Enter')
      await page.getByRole('note').filter({ visible: true }).getByText(/decides the next action of the spoon/).waitFor()
      assert.deepEqual(await accessibilityFaults(page), [])
      await page.keyboard.press('Escape')
      await page.locator('[popover]:popover-open').waitFor({ state: 'hidden' })
      await page.context().close()
    })

    it(`and to the jobs from anywhere, at ${width} px`, async () => {
      const page = await chromium.tab({ viewport: { width, height } })
      await chromium.open(page, 'powders')
      await unlock(page, service.token)
      const { id } = await service.post('/v1/calibrations', { powder: 'semolina', method: 'sequential', sets: 50, tolerance_deg: 0.1, trials_max: 500, seed: width })
      await page.getByRole('button', { name: /^Jobs\s*1$/ }).focus()
      await page.keyboard.press('Enter')
      const drawer = page.getByRole('dialog', { name: 'Jobs' })
      await drawer.getByRole('link', { name: /Calibration/ }).waitFor()
      assert.deepEqual(await accessibilityFaults(page), [])
      await picture(page, `jobs-drawer-${width}`)
      await drawer.getByRole('button', { name: 'Cancel' }).click()
      await drawer.getByText('Nothing is being computed').waitFor({ timeout: 60_000 })
      assert.equal((await service.get(`/v1/jobs/${id}`)).state, 'cancelled')
      await page.keyboard.press('Escape')
      await drawer.waitFor({ state: 'hidden' })
      await page.context().close()
    })
  }

  it('with every explained word in the glossary', async () => {
    const { readFileSync, readdirSync } = await import('node:fs')
    const here = (path) => new URL(path, import.meta.url)
    const words = ['views', 'parts'].flatMap((folder) => readdirSync(here(`../src/${folder}`)).map((name) => `${folder}/${name}`)).flatMap((name) => [...readFileSync(here(`../src/${name}`), 'utf8').matchAll(/ word(?:="|: ')([^"']+)/g)].map(([, word]) => word))
    const glossary = readFileSync(here('../../docs/glossary.md'), 'utf8')
    assert.ok(words.length >= 40, String(words.length))
    for (const word of words) assert.ok(glossary.includes(`\n| ${word} | `), word)
  })
})

describe('a refusal', () => {
  it('says in the words of the lab what is the matter, and leads to what helps', async () => {
    const page = await chromium.tab()
    await chromium.open(page, 'weighings')
    await unlock(page, service.token)
    await openPanel(page, 'Weigh a dose')
    const form = page.getByRole('form', { name: 'Weigh a dose', exact: true })
    await form.getByLabel('Powder', { exact: true }).selectOption('sugar')
    await form.getByRole('button', { name: 'Weigh', exact: true }).click()
    await form.getByRole('alert').getByText('Sugar has no calibration yet').waitFor()
    assert.deepEqual(await accessibilityFaults(page), [])
    await form.getByRole('link', { name: 'Calibrate Sugar' }).click()
    await page.getByRole('heading', { name: 'Start a calibration' }).waitFor()
    await page.getByRole('button', { name: 'Start the calibration' }).waitFor()
    await page.context().close()
  })
})
