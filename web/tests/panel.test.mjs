/** Forms that create something open at the right edge: the keyboard stays in them, what was typed stays, and the page stays where it is. */
import assert from 'node:assert/strict'
import { after, before, describe, it } from 'node:test'
import { accessibilityFaults, becomes, fits, openBrowser, openPanel, picture, unlock } from './browser.mjs'
import { startService } from './service.mjs'

let service, chromium, policy

before(async () => {
  service = await startService('--bench', 'emulated')
  chromium = await openBrowser(service.url)
  policy = (await service.get('/v1/policies')).items[0]?.id
}, { timeout: 120_000 })

after(async () => {
  await chromium?.browser.close()
  await service?.stop()
  assert.deepEqual(chromium?.complaints ?? [], [])
})

const FORMS = () => [
  ['weighings', 'Weigh a dose'],
  ['weighings', 'Weigh a list of doses'],
  ['powders', 'Add a measured powder'],
  ['powders', 'Calibrate Sand', 'Calibrate'],
  ['powders/sand', 'Calibrate'],
  ['powders/sand', 'Import measurements'],
  ['powders/sand', 'Measure by camera'],
  ['trainings', 'Start a training'],
  ...(policy ? [[`policies/${policy}`, 'Evaluate']] : []),
  ['investigations', 'Start an investigation'],
]
/** Height of the page once it no longer changes. */
async function settledHeight(page) {
  for (let last = -1; ; ) {
    const tall = await page.evaluate(() => document.documentElement.scrollHeight)
    if (tall === last) return tall
    last = tall
    await page.waitForTimeout(500)
  }
}
const focused = (page) => page.evaluate(() => !!document.activeElement?.closest('dialog[open]'))

for (const [width, height, colorScheme] of [[1440, 900, 'light'], [1280, 800, 'dark'], [390, 844, 'light']]) {
  describe(`forms at ${width} px`, () => {
    let page
    before(async () => {
      page = await chromium.tab({ viewport: { width, height }, colorScheme })
      await chromium.open(page)
      await unlock(page, service.token)
    })
    after(() => page.context().close())

    it('open at the right edge and move nothing, by the keyboard alone', async () => {
      for (const [view, button] of FORMS()) {
        await chromium.open(page, view)
        const opener = page.getByRole('button', { name: button, exact: true })
        await opener.waitFor()
        const tall = await settledHeight(page)
        await opener.focus()
        await page.keyboard.press('Enter')
        const panel = page.locator('dialog[open]')
        await panel.locator('form').first().waitFor()
        const box = await panel.boundingBox()
        assert.ok(Math.abs(box.x + box.width - width) < 1 && box.height >= height - 1, `${button}: ${JSON.stringify(box)}`)
        if (width < 400) assert.equal(box.width, width, button)
        assert.equal(await page.evaluate(() => document.documentElement.scrollHeight), tall, `${button} pushes nothing down`)
        await page.waitForFunction(() => document.activeElement?.closest('dialog[open]'))
        for (let k = 0; k < 30; k++) await page.keyboard.press('Tab')
        // The browser's own bar may be in the round; nothing of the page behind the panel is.
        assert.ok((await focused(page)) || (await page.evaluate(() => document.activeElement === document.body)), `${button} keeps the focus`)
        assert.ok(await fits(page), button)
        assert.deepEqual(await accessibilityFaults(page), [], button)
        await page.keyboard.press('Escape')
        await panel.waitFor({ state: 'detached' })
        await page.waitForFunction(() => !location.hash.includes('new=') && !location.hash.includes('calibrate='))
        // The button has the focus again.
        await becomes(async () => [button, await opener.evaluate((it) => it === document.activeElement)], [button, true])
      }
    })

    it('keep what was typed when they are closed by Escape, by their button or by Back', async () => {
      await chromium.open(page, 'weighings')
      const closings = [() => page.keyboard.press('Escape'), (panel) => panel.getByRole('button', { name: 'Close' }).click(), () => page.goBack()]
      for (const [k, close] of closings.entries()) {
        const panel = await openPanel(page, 'Weigh a dose')
        if (k > 0) await becomes(() => panel.getByLabel('Lot of the powder').inputValue(), `L-${k - 1}`)
        await panel.getByLabel('Lot of the powder').fill(`L-${k}`)
        await close(panel)
        await page.locator('dialog[open]').waitFor({ state: 'detached' })
        await page.waitForFunction(() => !location.hash.includes('new='))
      }
      const panel = await openPanel(page, 'Weigh a dose')
      await becomes(() => panel.getByLabel('Lot of the powder').inputValue(), 'L-2')
      await picture(page, `panel-${width}`)
    })

    it('are open where the address says so', async () => {
      await chromium.open(page, 'weighings?new=dose&powder=salt')
      const panel = page.getByRole('dialog', { name: 'Weigh a dose' })
      await becomes(() => panel.getByLabel('Powder', { exact: true }).inputValue(), 'salt')
      await page.keyboard.press('Escape')
      await panel.waitFor({ state: 'hidden' })
      await page.waitForURL(/#\/weighings\?powder=salt$/)
    })
  })
}

describe('a form that made something', () => {
  it('is not open again for who comes back', async () => {
    const page = await chromium.tab()
    await chromium.open(page, 'powders/sand')
    await unlock(page, service.token)
    const panel = await openPanel(page, 'Calibrate')
    await panel.getByLabel('Search method').selectOption('sequential')
    await panel.getByLabel('Particles').fill('400')
    await panel.getByRole('button', { name: 'Start the calibration' }).click()
    await page.getByRole('heading', { name: 'Calibration of Sand' }).waitFor()
    await page.goBack()
    await page.getByRole('heading', { name: 'Sand', level: 1 }).waitFor()
    await page.getByRole('button', { name: 'Calibrate', exact: true }).waitFor()
    assert.equal(await page.locator('dialog[open]').count(), 0)
    await page.context().close()
  })

  it('lets the bench be stopped while it is open', async () => {
    const page = await chromium.tab()
    const bench = await service.get('/v1/bench')
    await page.route('**/v1/bench', (route) => route.fulfill({ json: { ...bench, moving: '0193a000-0000-7000-8000-0000000000ab' } }))
    await chromium.open(page, 'weighings')
    await unlock(page, service.token)
    const panel = await openPanel(page, 'Weigh a dose')
    await panel.getByRole('button', { name: 'Stop', exact: true }).click()
    await panel.getByText(/^Stopped after \d+ ms$/).waitFor()
    assert.ok((await service.get('/v1/bench')).held)
    await page.context().close()
  })
})

describe('a viewer', () => {
  it('sees who may weigh and why, and no form', async () => {
    const { secret } = await service.post('/v1/tokens', { name: 'Vera', role: 'viewer' })
    const page = await chromium.tab()
    await chromium.open(page, 'weighings')
    await unlock(page, secret)
    await page.getByRole('button', { name: 'Weigh a dose', exact: true }).click()
    const panel = page.getByRole('dialog', { name: 'Weigh a dose' })
    await panel.getByText('An operator or an admin may do this.').waitFor()
    await panel.getByText('You are Vera, a viewer').waitFor()
    assert.equal(await panel.locator('form').count(), 0)
    assert.deepEqual(await accessibilityFaults(page), [])
    await picture(page, 'panel-viewer')
    await panel.getByRole('button', { name: 'Enter another token' }).click()
    await page.getByRole('dialog', { name: 'API token' }).waitFor()
    await page.context().close()
  })
})
