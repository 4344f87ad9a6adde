/** The page in German and Japanese: chosen, remembered, and whole where powder moves; English elsewhere, and marked so. */
import assert from 'node:assert/strict'
import { after, before, describe, it } from 'node:test'
import { accessibilityFaults, becomes, csvOf, fits, openBrowser, picture, unlock } from './browser.mjs'
import { startService } from './service.mjs'

let service, chromium, bench
const SIZES = [[1440, 900], [1280, 800], [390, 844]]
const AT = '2026-01-02T03:04:05Z'
const ID = '01930000-0000-7000-8000-00000000000'
const WAITING = [
  { id: `${ID}1`, powder: 'salt', target_mg: 12, vial: 'A1', state: 'planned' },
  { id: `${ID}2`, powder: 'sand', target_mg: 8.5, vial: null, state: 'planned' },
]

before(async () => {
  service = await startService()
  bench = await service.get('/v1/bench')
  chromium = await openBrowser(service.url)
}, { timeout: 60_000 })

after(async () => {
  await chromium?.browser.close()
  await service?.stop()
  assert.deepEqual((chromium?.complaints ?? []).filter((text) => !/ERR_FAILED/.test(text)), [])
})

const langOf = (page) => page.evaluate(() => document.documentElement.lang)
const choose = (page, name) => page.locator('header select').selectOption({ label: name })
/** A bench that moves until it is stopped, and is held until it is resumed. */
async function moves(page, said) {
  let now = { ...bench, moving: `${ID}3`, waiting: WAITING }
  await page.route('**/v1/bench', (route) => route.fulfill({ json: now }))
  for (const [path, after] of [['stop', { moving: null, held: { at: AT, reason: 'a person stopped the bench', by: 'Ada' } }], ['resume', { held: null, waiting: [] }]])
    await page.route(`**/v1/bench/${path}`, (route) => {
      said.push([path, route.request().postDataJSON()])
      now = { ...now, ...after }
      return route.fulfill({ json: now })
    })
}
const sound = async (page, width) => {
  assert.ok(await fits(page), `wider than ${width} px`)
  assert.deepEqual(await accessibilityFaults(page), [])
}

describe('a language', () => {
  it('is that of the browser at first, of what the page has', async () => {
    for (const [locale, lang, ready] of [['de-AT', 'de', 'Bereit'], ['ja-JP', 'ja', '準備完了'], ['fr-FR', 'en', 'Ready']]) {
      const page = await chromium.tab({ locale })
      await chromium.open(page)
      await page.getByRole('heading', { name: ready, level: 1 }).waitFor()
      await becomes(() => langOf(page), lang)
      await page.context().close()
    }
  })

  it('costs an English reader no file', async () => {
    const page = await chromium.tab()
    const asked = []
    page.on('request', (request) => asked.push(request.url()))
    await chromium.open(page)
    await page.waitForTimeout(6000)
    // The second file has been fetched ahead.
    await becomes(() => asked.some((url) => /later/.test(url)), true)
    assert.deepEqual(asked.filter((url) => /texts/.test(url)), [])
    await page.context().close()
  })

  it('survives a reload, reaches the other tabs, and can be changed back from the keyboard', async () => {
    const page = await chromium.tab()
    await chromium.open(page)
    const other = await chromium.beside(page.context())
    await chromium.open(other)
    await choose(page, '日本語')
    for (const tab of [page, other]) await tab.getByRole('heading', { name: '準備完了', level: 1 }).waitFor()
    await page.reload()
    await page.getByRole('heading', { name: '準備完了', level: 1 }).waitFor()
    await becomes(() => page.title(), /^コンソール · FLIP$/)
    await page.getByRole('combobox', { name: '言語' }).focus()
    await page.keyboard.press('E')
    await page.getByRole('heading', { name: 'Ready', level: 1 }).waitFor()
    await becomes(() => langOf(page), 'en')
    await page.context().close()
  })

  it('that does not arrive leaves the one before, says so, and can be asked for again', async () => {
    const page = await chromium.tab()
    await chromium.open(page)
    await page.route('**/*texts_de*', (route) => route.abort())
    await choose(page, 'Deutsch')
    const alert = page.getByRole('alert').filter({ hasText: 'The language could not be loaded.' })
    await alert.waitFor()
    await page.getByRole('heading', { name: 'Ready', level: 1 }).waitFor()
    assert.deepEqual(await accessibilityFaults(page), [])
    await page.unrouteAll()
    await alert.getByRole('button', { name: 'Try again' }).click()
    await page.getByRole('heading', { name: 'Bereit', level: 1 }).waitFor()
    await becomes(() => alert.count(), 0)
    await page.context().close()
  })
})

describe('in German', () => {
  for (const [width, height] of SIZES)
    it(`a dose is stopped, held and resumed, at ${width} px`, async () => {
      const page = await chromium.tab({ viewport: { width, height } })
      const said = []
      await chromium.open(page)
      await unlock(page, service.token)
      await choose(page, 'Deutsch')
      await page.getByRole('heading', { name: 'Bereit', level: 1 }).waitFor()
      await sound(page, width)
      await picture(page, `language-de-console-${width}`)
      await moves(page, said)
      await page.reload()
      await page.getByRole('heading', { name: 'In Bewegung', level: 1 }).waitFor()
      const strip = page.getByRole('region', { name: 'Wägeplatz jetzt' })
      await strip.getByText('Eine Einwaage läuft; 2 weitere warten. Diese Taste ist kein Not-Halt; der Not-Halt ist fest verdrahtet.').waitFor()
      await page.getByRole('list', { name: 'Wartende Einwaagen' }).getByText('12.00 mg Salt, Vial A1').waitFor()
      await sound(page, width)
      await picture(page, `language-de-moving-${width}`)
      await page.getByRole('button', { name: 'Stopp', exact: true }).click()
      await strip.getByText(/^Gestoppt von Ada, .*2026.*: Nichts beginnt, bis jemand den Betrieb fortsetzt\.$/).waitFor()
      await strip.getByText(/^Gestoppt nach \d+ ms$/).waitFor()
      await strip.getByText('2 Einwaagen warten.').waitFor()
      await page.getByRole('main').getByRole('button', { name: 'Betrieb fortsetzen' }).click()
      const form = page.getByRole('form', { name: 'Betrieb fortsetzen' })
      await form.getByLabel('Ihr Name').fill('Ada')
      await form.getByLabel('Notiz').fill('Löffel gereinigt')
      await sound(page, width)
      await picture(page, `language-de-held-${width}`)
      await form.getByRole('button', { name: 'Fortsetzen', exact: true }).click()
      await form.waitFor({ state: 'detached' })
      assert.deepEqual(said, [['stop', null], ['resume', { by: 'Ada', note: 'Löffel gereinigt' }]])
      await page.context().close()
    })

  it('a latched bench is cleared, and its reason is marked as English', async () => {
    const page = await chromium.tab({ locale: 'de-DE' })
    await page.route('**/v1/bench', (route) => route.fulfill({ json: { ...bench, latch: { at: AT, reason: 'The process ended while the spoon moved.', weighing: `${ID}3` } } }))
    await chromium.open(page, 'bench')
    const form = page.getByRole('form', { name: 'Wägeplatz freigeben' })
    await form.getByLabel('Ich habe Löffel, Vial und Waage geprüft.').check()
    assert.equal(await page.getByRole('main').getByText('The process ended while the spoon moved.').evaluate((it) => it.closest('[lang]').lang), 'en')
    assert.equal(await form.evaluate((it) => it.closest('[lang]').lang), 'de')
    // The record is not translated.
    assert.equal(await page.getByRole('main').getByRole('table').first().evaluate((it) => it.closest('[lang]').lang), 'en')
    await sound(page)
    await page.context().close()
  })

  it('a refusal names its remedy, and what the service said is marked as English', async () => {
    const page = await chromium.tab({ locale: 'de-DE' })
    await chromium.open(page, 'weighings?powder=semolina')
    await page.getByRole('button', { name: 'Nur lesen' }).click()
    const dialog = page.getByRole('dialog', { name: 'API-Token' })
    await dialog.getByLabel('Token').first().fill('nonsense')
    await dialog.getByRole('button', { name: 'Dieses Token verwenden' }).click()
    await dialog.getByRole('alert').getByText('Ein gültiges Token ist nötig').waitFor()
    await sound(page)
    await dialog.getByLabel('Token').first().fill(service.token)
    await dialog.getByRole('button', { name: 'Dieses Token verwenden' }).click()
    await page.getByRole('button', { name: 'Neue Einwaage', exact: true }).click()
    const form = page.getByRole('form', { name: 'Neue Einwaage', exact: true })
    await form.getByLabel('Sollwert').fill('12')
    await form.getByRole('button', { name: 'Einwiegen', exact: true }).click()
    const refusal = form.getByRole('alert')
    await refusal.getByText(/Semolina ist noch nicht kalibriert/).waitFor()
    await refusal.getByText('Was der Dienst meldet').click()
    await becomes(() => refusal.locator('details p').getAttribute('lang'), 'en')
    await refusal.getByRole('link', { name: 'Semolina kalibrieren' }).waitFor()
    await sound(page)
    await picture(page, 'language-de-refusal')
    await page.context().close()
  })

  it('the table of the last doses has German headings and verdicts, and its CSV the English ones', async () => {
    const page = await chromium.tab({ locale: 'de-DE' })
    const dose = { id: `${ID}4`, powder: 'sand', target_mg: 15, tolerance_lower_mg: 1, tolerance_upper_mg: 1, state: 'done', outcome: 'within', reading_mg: 15.2, measured: null, asked: { lot: 'L7' }, created_at: AT, started_at: AT, finished_at: AT }
    await page.route('**/v1/weighings?*', (route) => route.fulfill({ json: { items: [dose], next: null, total: 1 } }))
    await chromium.open(page)
    const table = page.getByRole('table', { name: 'Letzte Einwaagen' })
    await table.getByText('In Toleranz').waitFor()
    await becomes(() => table.getByRole('columnheader').allTextContents(), ['Pulver', 'Ergebnis', 'Sollwert (mg)', 'Anzeige (mg)', 'Abweichung (mg)', 'Charge, Vial', 'Beendet'])
    const { rows } = await csvOf(page, 'Letzte Einwaagen', 'CSV: Letzte Einwaagen')
    assert.deepEqual(rows, [['Powder', 'Verdict', 'Target (mg)', 'Reading (mg)', 'Error (mg)', 'Lot, vial', 'Ended'], ['Sand', 'Within', '15.00', '15.2', '+0.20', 'L7', AT]])
    await page.context().close()
  })

  it('a view that is not translated is in English throughout, and a screen reader is told so', async () => {
    const page = await chromium.tab({ locale: 'de-DE' })
    await chromium.open(page, 'jobs')
    const view = page.getByRole('heading', { name: 'Jobs', level: 1 })
    assert.equal(await view.evaluate((it) => it.closest('[lang]').lang), 'en')
    await page.getByRole('main').getByRole('button', { name: 'CSV of Jobs' }).waitFor()
    const views = page.getByRole('navigation', { name: 'Ansichten' })
    assert.equal(await views.evaluate((it) => it.closest('[lang]').lang), 'de')
    await views.getByRole('link', { name: 'Pulver' }).click()
    await page.getByRole('heading', { name: 'Powders', level: 1 }).waitFor()
    await sound(page)
    await page.context().close()
  })
})

describe('in Japanese', () => {
  for (const [width, height] of SIZES)
    it(`a dose is requested, with the checklist and a list, at ${width} px`, async () => {
      const page = await chromium.tab({ locale: 'ja-JP', viewport: { width, height } })
      await page.route('**/v1/bench', (route) => route.fulfill({ json: { ...bench, kind: 'emulated', exchanges_vials: true } }))
      await chromium.open(page, 'weighings?new=dose')
      await page.getByRole('heading', { name: '秤量', level: 1, includeHidden: true }).waitFor()
      const form = page.getByRole('form', { name: '新しい秤量' })
      await form.getByLabel('目標値').fill('12')
      await form.getByText('室内の空気、正確さ、過量投入').click()
      await becomes(() => form.getByLabel('過量投入のあと').locator('option').allTextContents().then((all) => all.slice(0, 3)), ['報告して終了', '新しいバイアルでやり直し、最大 1 回', '新しいバイアルでやり直し、最大 2 回'])
      await form.getByRole('group', { name: '秤量の前に' }).waitFor()
      await chromium.open(page, 'weighings?new=list')
      await page.getByRole('form', { name: 'リストで秤量' }).getByLabel('リストの名前').fill('A')
      await sound(page, width)
      await picture(page, `language-ja-weigh-${width}`)
      await page.route('**/v1/bench', (route) => route.fulfill({ json: { ...bench, moving: `${ID}3`, waiting: WAITING } }))
      await chromium.open(page, 'wall')
      await page.getByRole('heading', { name: '動作中', level: 1 }).waitFor()
      await page.getByText('次: Salt 12.00 mg、バイアル A1。 2 件の秤量が待機中です。').waitFor()
      await page.getByRole('button', { name: '停止', exact: true }).waitFor()
      await sound(page, width)
      await picture(page, `language-ja-wall-${width}`)
      await page.context().close()
    })
})
