/** Labels that callers write on doses and jobs: shown, a press away from all that have the same, typed in the forms, and refused in words. */
import assert from 'node:assert/strict'
import { after, before, describe, it } from 'node:test'
import { fileURLToPath } from 'node:url'
import { createServer } from 'vite'
import { accessibilityFaults, becomes, fits, openBrowser, openPanel, picture, unlock } from './browser.mjs'
import { startService } from './service.mjs'

describe('what a person types', () => {
  let vite, read
  before(async () => {
    vite = await createServer({ root: fileURLToPath(new URL('..', import.meta.url)), server: { middlewareMode: true, ws: false, watch: null }, appType: 'custom', logLevel: 'error' })
    read = await vite.ssrLoadModule('/src/caller_labels.ts')
  })
  after(() => vite.close())
  const said = (text, values) => Object.entries(values).reduce((words, [name, value]) => words.replace(`{${name}}`, value), text)
  const fault = (text) => read.labelsFault(text, said)

  it('is one label per line, as the service reads it', () => {
    assert.deepEqual(read.labelsOf('plate: A7\n\n url:http://x:1/ \nnote:Grüße, "8"\nempty:'), { plate: 'A7', url: 'http://x:1/', note: 'Grüße, "8"', empty: '' })
    assert.deepEqual(read.labelsOf(''), {})
    assert.deepEqual(Object.keys(read.labelsOf('__proto__:a')), ['__proto__'])
  })

  it('may be all that the service takes, and no more', () => {
    const lines = (n, value = 'v') => Array.from({ length: n }, (_, k) => `k${k}:${value}`).join('\n')
    for (const good of ['', 'lab.example/run-2_b:x', `${'k'.repeat(63)}:v`, `k:${'𝄞'.repeat(255)}`, lines(32)]) assert.equal(fault(good), undefined, good)
    for (const [wrong, words] of [
      ['plate:A7\nstudy', 'Line 2: must be a key and its value, as plate:A7'],
      [':A7', /^Line 1: the key must be 1 to 63 letters/],
      ['a b:c', /^Line 1: the key/],
      ['ä:c', /^Line 1: the key/],
      [`${'k'.repeat(64)}:v`, /^Line 1: the key/],
      [`k:${'v'.repeat(256)}`, /at most 255 characters/],
      ['k:a\tb', /without tabs/],
      ['a:1\nb:2\na:3', 'Line 3: a has a value already'],
      [lines(33), 'At most 32 labels, got 33'],
      [lines(17, 'v'.repeat(255)), 'At most 4096 bytes in all, got 4376'],
    ])
      assert.match(fault(wrong) ?? '', words instanceof RegExp ? words : new RegExp(`^${words}$`), wrong)
  })

  it('is filled in again for the same dose, less the id of its request', () => {
    assert.equal(read.labelsText({ correlation_id: 'run-7', plate: 'A7', url: 'http://x:1/' }), 'plate:A7\nurl:http://x:1/')
    assert.equal(read.labelsText(), '')
  })
})

describe('on the page', () => {
  let service, chromium, page, dose, job
  const WIDTHS = [1440, 1280, 390]
  const LONG = `${'word '.repeat(30)}${'x'.repeat(100)}`
  const request = (labels) => ({ powder: 'sand', target: { value: 12, unit: 'mg' }, tolerance: { lower: 1, upper: 1, unit: 'mg' }, labels })

  before(async () => {
    service = await startService()
    const calibration = { powder: 'sand', method: 'sequential', sets: 2, tolerance_deg: 5, trials_max: 60, particles: 400, labels: { team: 'a', campaign: 'May' } }
    job = (await service.post('/v1/calibrations', calibration, { 'x-correlation-id': 'run-7/1' })).id
    await service.finished(job)
    dose = (await service.post('/v1/weighings', request({ plate: 'A7', 'eln/url': 'http://x:1/?a=b&c', note: LONG }), { 'idempotency-key': 'one', 'x-correlation-id': 'run-7/2' })).id
    await service.post('/v1/weighings', request({ plate: 'A8' }), { 'idempotency-key': 'two' })
    await service.post('/v1/weighings', request({}), { 'idempotency-key': 'three' })
    chromium = await openBrowser(service.url)
    page = await chromium.tab({ viewport: { width: 1440, height: 900 } })
    await chromium.open(page)
    await unlock(page, service.token)
  }, { timeout: 900_000 })

  after(async () => {
    await chromium?.browser.close()
    await service?.stop()
  })

  const asked = () => new URLSearchParams(page.url().split('?')[1]).get('label')
  const field = () => page.locator('.filters').getByRole('textbox', { name: 'Label' })
  const told = async (text) => page.locator('.filters').getByRole('status').getByText(text, { exact: true }).waitFor()
  const rows = (table) => page.getByRole('table', { name: table }).getByRole('rowheader')
  const label = (text) => page.locator('dl', { has: page.getByText('Labels', { exact: true }) }).getByRole('link', { name: text, exact: true })
  const refused = () => page.getByRole('alert').getByText('must be a key and its value')

  it('a dose shows its labels, the id of its request among them', async () => {
    await chromium.open(page, `weighings/${dose}`)
    for (const text of ['correlation_id: run-7/2', 'eln/url: http://x:1/?a=b&c', `note: ${LONG}`, 'plate: A7']) await label(text).waitFor()
    await picture(page, 'labels-dose')
  })

  it('a press on one lists the doses that have it, by its address', async () => {
    for (const [text, wanted] of [['plate: A7', 'plate:A7'], ['eln/url: http://x:1/?a=b&c', 'eln/url:http://x:1/?a=b&c'], ['correlation_id: run-7/2', 'correlation_id:run-7/2']]) {
      await chromium.open(page, `weighings/${dose}`)
      await label(text).press('Enter')
      await told('1 match')
      await becomes(asked, wanted)
      await becomes(() => field().inputValue(), wanted)
      assert.match(await rows('Weighings').getByRole('link').getAttribute('href'), new RegExp(`${dose}$`))
    }
    await page.reload()
    await told('1 match')
    await page.goBack()
    await label('plate: A7').waitFor()
  })

  it('the list is filtered by what is typed, and shown whole again by one press', async () => {
    await chromium.open(page, 'weighings')
    await told('3 in all')
    await field().fill(' plate: A8 ')
    await field().press('Enter')
    await told('1 match')
    await becomes(asked, 'plate: A8')
    await field().fill('plate:a8')
    await field().press('Enter')
    await told('0 match')
    await page.getByText('No weighing matches.').waitFor()
    await page.getByRole('button', { name: 'Show all' }).click()
    await told('3 in all')
    await becomes(() => [asked(), page.url().includes('label')], [null, false])
    await becomes(() => field().inputValue(), '')
  })

  it('what is no label is refused in words, and no dose stands there as if it had it', async () => {
    await chromium.open(page, 'weighings')
    await told('3 in all')
    await field().fill('plate')
    await field().press('Enter')
    await refused().waitFor()
    await page.getByRole('alert').getByText('as `plate:A7`, got `plate`').waitFor()
    await becomes(() => field().getAttribute('aria-invalid'), 'true')
    await becomes(() => rows('Weighings').count(), 0)
    assert.equal(await page.locator('.filters').getByRole('status').count(), 0)
    assert.deepEqual(await accessibilityFaults(page), [])
    await picture(page, 'labels-refused')
    await field().fill('plate:A7')
    await field().press('Enter')
    await told('1 match')
    await becomes(() => page.getByRole('alert').count(), 0)
    await becomes(() => field().getAttribute('aria-invalid'), null)
    await chromium.open(page, 'weighings?label=plate')
    await refused().waitFor()
    await chromium.open(page, 'jobs?label=plate')
    await refused().waitFor()
    await becomes(() => rows('Jobs').count(), 0)
  })

  it('a job shows its labels, and a press on one lists the jobs that have it', async () => {
    await chromium.open(page, `calibrations/${job}`)
    for (const text of ['campaign: May', 'correlation_id: run-7/1']) await label(text).waitFor()
    await label('team: a').click()
    await page.waitForURL(/#\/jobs\?label=team%3Aa$/)
    await becomes(() => rows('Jobs').count(), 1)
    await becomes(() => field().inputValue(), 'team:a')
    await field().fill('team:b')
    await field().press('Enter')
    await page.getByText('No job matches.').waitFor()
    await becomes(() => rows('Jobs').count(), 0)
  })

  it('the form for a dose takes them, and says what is wrong with one before anything is sent', async () => {
    await chromium.open(page, 'weighings?powder=sand')
    const panel = await openPanel(page, 'Weigh a dose')
    const labels = panel.getByLabel('Labels')
    await panel.getByText('One per line, as plate:A7').waitFor()
    await labels.fill('plate:B1\nstudy X')
    let sent = 0
    page.on('request', (it) => (sent += it.method() === 'POST' ? 1 : 0))
    await panel.getByRole('button', { name: 'Weigh', exact: true }).click()
    await panel.getByText('Line 2: must be a key and its value, as plate:A7').waitFor()
    await becomes(() => labels.getAttribute('aria-invalid'), 'true')
    await becomes(() => labels.evaluate((it) => it === document.activeElement), true)
    assert.deepEqual(await accessibilityFaults(page), [])
    await picture(page, 'labels-form')
    await labels.fill('plate:B1\nstudy: X: 2')
    await panel.getByText('One per line, as plate:A7').waitFor()
    assert.equal(sent, 0)
    await panel.getByRole('button', { name: 'Weigh', exact: true }).click()
    await page.waitForURL(/#\/weighings\/[0-9a-f-]{36}/)
    await label('study: X: 2').waitFor()
    const { weighing } = await service.get(`/v1/weighings/${page.url().match(/[0-9a-f-]{36}/)[0]}`)
    assert.deepEqual(weighing.labels, { plate: 'B1', study: 'X: 2' })
  })

  it('a dose that is asked for again has those of the first, less the id of its request', async () => {
    await chromium.open(page, `weighings?again=${dose}`)
    await becomes(() => page.getByRole('dialog', { name: 'Weigh a dose' }).getByLabel('Labels').inputValue(), `eln/url:http://x:1/?a=b&c\nnote:${LONG}\nplate:A7`)
  })

  it('the form for a list writes them on every dose', async () => {
    await chromium.open(page, 'weighings')
    const panel = await openPanel(page, 'Weigh a list of doses')
    await panel.getByLabel('Name of the list').fill('Plate 9')
    await panel.getByLabel('Doses', { exact: true }).fill('powder\ttarget_mg\nsand\t12\nsand\t9')
    await panel.getByLabel('Labels').fill('plate:P9')
    await panel.getByRole('button', { name: 'Check the list' }).click()
    await page.getByRole('button', { name: 'Weigh these 2 doses' }).click()
    await page.waitForURL(/#\/weighings\?list=Plate/)
    await chromium.open(page, 'weighings?label=plate:P9')
    await told('2 match')
  })

  it('the form speaks the language of the page', async () => {
    const other = await chromium.tab({ locale: 'de-DE' })
    await chromium.open(other, 'weighings?new=dose&powder=sand')
    const labels = other.getByRole('dialog').getByLabel('Labels')
    await other.getByText('Eine je Zeile, wie plate:A7').waitFor()
    await labels.fill('plate')
    await becomes(() => labels.evaluate((it) => it.validationMessage), 'Zeile 1: Erwartet werden Schlüssel und Wert, wie plate:A7')
    await other.context().close()
  })

  for (const width of WIDTHS) {
    it(`fits a window of ${width} px, and axe finds nothing`, async () => {
      await page.setViewportSize({ width, height: 900 })
      const views = [
        ['dose', `weighings/${dose}`, () => label('plate: A7')],
        ['job', `calibrations/${job}`, () => label('team: a')],
        ['doses', 'weighings?label=plate:A7', () => rows('Weighings').first()],
        ['jobs', 'jobs?label=team:a', () => rows('Jobs').first()],
        ['form', 'weighings?new=dose', () => page.getByRole('dialog').getByLabel('Labels')],
      ]
      for (const [name, view, shown] of views) {
        await chromium.open(page, view)
        await shown().waitFor()
        assert.ok(await fits(page), view)
        assert.deepEqual(await accessibilityFaults(page), [], view)
        await picture(page, `labels-${name}-${width}`)
      }
    })
  }

  it('nothing was complained about', () => assert.deepEqual(chromium.complaints, []))
})
