/** What a person sees and does on the page, in a real Chromium before a real `flip serve`. */
import assert from 'node:assert/strict'
import { createHash } from 'node:crypto'
import { readFileSync } from 'node:fs'
import { after, before, describe, it } from 'node:test'
import { accessibilityFaults, becomes, csvAsShown, fits, holds, openBrowser, openPanel, picture, tableCells, unlock } from './browser.mjs'
import { startService } from './service.mjs'
import { explanations, unexplained } from './words.mjs'

let service, chromium, page
/** Small stored results: two calibrations, a training of a few episodes, an evaluation, a dose. */
const made = {}

before(async () => {
  service = await startService()
  const { post, finished, get } = service
  for (const powder of ['sand', 'sugar']) {
    made[powder] = await post('/v1/calibrations', SMALL_CALIBRATION(powder))
  }
  for (const powder of ['sand', 'sugar']) await finished(made[powder].id)
  made.training = await post('/v1/trainings', { episodes: 4, powders: ['sand'] })
  await finished(made.training.id)
  made.policy = (await get(`/v1/trainings/${made.training.id}`)).result.policy
  made.evaluation = await post('/v1/evaluations', { policy: made.policy, powders: ['sand'], targets_mg: [15], repeats: 1, controllers: ['policy', 'fixed'] })
  await finished(made.evaluation.id)
  chromium = await openBrowser(service.url)
  page = await chromium.tab()
}, { timeout: 900_000 })

after(async () => {
  await chromium?.browser.close()
  await service?.stop()
})

/** Few grains make quick heaps, but only flat ones: sand and sugar. */
const SMALL_CALIBRATION = (powder) => ({ powder, method: 'sequential', sets: 2, tolerance_deg: 5, trials_max: 60, particles: 400 })
const table = (caption) => page.getByRole('table', { name: caption, exact: true })
const row = (caption, name) => table(caption).getByRole('row').filter({ hasText: name })
const degrees = (value) => value.toFixed(2)

/** The view's CSV is what its table shows. */
async function csvEqualsTable(caption) {
  const rows = await csvAsShown(page, caption)
  assert.ok(rows.length > 1, `${caption} has rows`)
  return rows
}

describe('the overview', () => {
  it('tells the story of the five powders with the numbers the service holds', async () => {
    await chromium.open(page, 'story')
    await table('Powders, from measured pile to last weighed dose').waitFor()
    const rows = await csvEqualsTable('Powders, from measured pile to last weighed dose')
    const { items } = await service.get('/v1/powders')
    assert.deepEqual(rows.slice(1).map(([name, angle]) => [name, angle]), items.map((p) => [p.name, degrees(p.flowability.repose_deg)]))
    for (const stage of ['Measured pile', 'Simulated powder', 'Policy', 'Weighed dose']) await page.getByRole('heading', { name: stage, level: 2 }).waitFor()
    await page.getByRole('img', { name: /Measured angles of repose: .*Semolina 42\.8 degrees/ }).waitFor()
  })
})

describe('powders', () => {
  it('lists mean, SD and n of each method as published', async () => {
    await chromium.open(page, 'powders')
    const rows = await csvEqualsTable('Powders and their measurements')
    const semolina = rows.find(([name]) => name === 'Semolina')
    assert.deepEqual(semolina.slice(1, 7), ['42.76', '1.97', '5', '40.91', '1.85', '5'])
    await page.getByRole('img', { name: /Angles of repose\. Sand: measured 28\.6/ }).waitFor()
  })

  it('shows the calibrated sets of a powder with their nine parameters and error', async () => {
    await chromium.open(page, 'powders/sand')
    const rows = await csvEqualsTable('Calibrated parameter sets')
    const { sets } = await service.get('/v1/powders/sand')
    assert.equal(rows.length - 1, sets.length)
    assert.equal(rows[0].length, 14)
    assert.deepEqual(rows.slice(1).map((cells) => cells.at(-1)), sets.map((s) => degrees(s.error_deg)))
  })

  it('adds a measured powder from the form', async () => {
    await chromium.open(page, 'powders')
    await unlock(page, service.token)
    await openPanel(page, 'Add a measured powder')
    await page.getByLabel('Name').fill('Lactose 200M')
    await page.getByLabel('Mean (°)').fill('46.5')
    await page.getByLabel('SD (°)').fill('1.2')
    await page.getByRole('button', { name: 'Add the measurement' }).click()
    await page.getByText('Lactose 200M was added.').waitFor()
    await row('Powders and their measurements', 'Lactose 200M').waitFor()
    const { powder, measurements } = await service.get('/v1/powders/lactose_200m')
    assert.deepEqual([powder.name, measurements[0].repose_deg, measurements[0].n], ['Lactose 200M', 46.5, 5])
  })

  it('says beside the field what is wrong with an impossible measurement', async () => {
    await page.getByLabel('Name').fill('Impossible')
    await page.getByLabel('Mean (°)').fill('95')
    await page.getByLabel('SD (°)').fill('1')
    await page.getByRole('button', { name: 'Add the measurement' }).click()
    const field = page.getByLabel('Mean (°)')
    await page.waitForFunction((input) => input.getAttribute('aria-invalid') === 'true', await field.elementHandle())
    await becomes(() => field.evaluate((input) => document.getElementById(input.getAttribute('aria-describedby')).textContent), /85/)
  })
})

describe('a calibration', () => {
  it('is started from the form and watched until it has converged', async () => {
    await chromium.open(page, 'powders')
    await unlock(page, service.token)
    await chromium.open(page, 'powders?calibrate=sand')
    await page.getByLabel('Search method').selectOption('sequential')
    await page.getByLabel('Sets to keep').fill('1')
    await page.getByLabel('Tolerance (°)').fill('5')
    await page.getByLabel('Maximum trials').fill('40')
    await page.getByLabel('Particles').fill('400')
    await page.getByLabel('Seed').fill('2')
    await page.getByRole('button', { name: 'Start the calibration' }).click()
    await page.getByRole('heading', { name: 'Calibration of Sand' }).waitFor()
    await page.locator('main .badge', { hasText: 'Succeeded' }).waitFor({ timeout: 120_000 })
    await table('Calibrated parameter sets').waitFor()
  })

  it('draws every trial against target and tolerance, with the table and CSV of the plot', async () => {
    const id = made.sugar.id
    await chromium.open(page, `calibrations/${id}`)
    for (const plot of ['Angle of repose per trial', 'Error per trial']) {
      await page.getByText(`Table of ${plot}`).click()
      await csvEqualsTable(plot)
    }
    const { items } = await service.get(`/v1/calibrations/${id}/trials?limit=5000`)
    const errors = await tableCells(table('Error per trial'))
    assert.deepEqual(errors.slice(1).map((cells) => cells[1]), items.map((t) => (typeof t.error_deg === 'number' ? degrees(t.error_deg) : '')))
    await page.getByText('Target 31.41°').waitFor()
    await page.getByText('Within ± 5.0°').waitFor()
  })

  it('reads the points of a plot to the keyboard', async () => {
    const plot = page.getByRole('group', { name: /Angle of repose per trial/ })
    await plot.focus()
    await page.keyboard.press('ArrowRight')
    await page.keyboard.press('ArrowRight')
    await page.getByText(/^Trial 2 · Search /).waitFor()
  })
})

describe('a training', () => {
  it('shows error, reward and temperature of every episode over its levels', async () => {
    await chromium.open(page, `trainings/${made.training.id}`)
    const { items } = await service.get(`/v1/trainings/${made.training.id}/episodes?limit=5000`)
    for (const plot of ['Error at the end of the episode', 'Reward of the episode', 'Entropy temperature']) {
      await page.getByText(`Table of ${plot}`).click()
      assert.equal((await csvEqualsTable(plot)).length - 1, items.length)
    }
    const errors = await tableCells(table('Error at the end of the episode'))
    assert.deepEqual(errors.slice(1).map((cells) => cells[1]), items.map((e) => e.final_error_mg.toFixed(2)))
    await row('Curriculum levels', 'Sand').waitFor()
  })

  it('is started from the form in every order', async () => {
    for (const order of ['Random', 'Reverse', 'Domain randomisation']) {
      await chromium.open(page, 'trainings')
      await unlock(page, service.token)
      const form = await openPanel(page, 'Start a training')
      await form.getByLabel('Order of the levels').selectOption(order)
      // Sand and sugar are calibrated; nothing is chosen where powders are drawn from the whole box.
      if (order !== 'Domain randomisation') await form.getByLabel('Salt').uncheck()
      await form.getByLabel('Episodes').fill('4')
      await page.getByRole('button', { name: 'Start the training' }).click()
      await page.getByText('Table of Reward of the episode').waitFor()
      await page.locator('main .badge', { hasText: 'Succeeded' }).waitFor({ timeout: 120_000 })
    }
  })

  it('is listed with its policy', async () => {
    await chromium.open(page, 'trainings')
    await table('Trainings').getByRole('link', { name: made.policy }).waitFor()
    await csvEqualsTable('Trainings')
  })
})

describe('a policy', () => {
  it('shows its lineage and its evaluation', async () => {
    await chromium.open(page, `policies/${made.policy}`)
    await page.getByRole('link', { name: 'This training' }).waitFor()
    await page.getByRole('button', { name: `Copy the ID …${made.training.id.slice(-8)}` }).waitFor()
    const rows = await csvEqualsTable('Errors by powder and target')
    const { result } = await service.get(`/v1/evaluations/${made.evaluation.id}`)
    assert.deepEqual(rows.slice(1).map((cells) => cells[4]), result.rows.map((r) => r.mae_mg.toFixed(2)))
    await csvEqualsTable('Controllers compared')
  })

  it('gives its weights with the hash it names, and its manifest', async () => {
    const { sha256, manifest } = await service.get(`/v1/policies/${made.policy}`)
    const take = async (button) => {
      const [file] = await Promise.all([page.waitForEvent('download'), page.getByRole('button', { name: button }).click()])
      return [file.suggestedFilename(), readFileSync(await file.path())]
    }
    const [name, bytes] = await take(/Weights/)
    assert.equal(name, `${made.policy}.safetensors`)
    assert.equal(createHash('sha256').update(bytes).digest('hex'), sha256)
    const [, json] = await take(/Manifest/)
    assert.deepEqual(JSON.parse(json), manifest)
  })
})

describe('a weighing', () => {
  it('cannot be started without a token, and the page says how to get one', async () => {
    const stranger = await chromium.tab()
    await chromium.open(stranger, 'weighings?new=dose')
    await stranger.getByRole('button', { name: 'Enter an operator token to write' }).click()
    await stranger.getByText('flip token create --role operator').waitFor()
    await stranger.keyboard.press('Escape')
    await stranger.getByText('flip token create --role operator').waitFor({ state: 'hidden' })
    await stranger.keyboard.press('Escape')
    await unlock(stranger, service.token)
    const kept = await stranger.evaluate(() => [sessionStorage.getItem('flip-token'), JSON.stringify(localStorage), document.cookie])
    assert.equal(kept[0], service.token)
    assert.ok(!kept[1].includes(service.token) && !kept[2].includes(service.token), 'the token is kept in this tab only')
    await stranger.context().close()
  })

  it('is started from the form and followed until its verdict', async () => {
    await chromium.open(page, 'weighings?powder=sand')
    await unlock(page, service.token)
    const form = await openPanel(page, 'Weigh a dose')
    await form.getByLabel('Target').fill('0.012')
    await form.getByLabel('Unit').first().selectOption('g')
    await form.getByLabel('Tolerance −').fill('10')
    await form.getByLabel('Tolerance +').fill('10')
    await form.getByLabel('Unit').last().selectOption('%')
    await form.getByRole('button', { name: 'Weigh' }).click()
    await page.getByRole('heading', { name: '12.00 mg of Sand' }).waitFor()
    made.weighing = new URL(page.url()).hash.split('/').at(-1)
    await page.locator('.verdict').getByText(/^(Within|Under|Over)$/).waitFor({ timeout: 120_000 })
    const { weighing, ticks } = await service.get(`/v1/weighings/${made.weighing}`)
    assert.ok(Math.abs(weighing.tolerance_upper_mg - 1.2) < 1e-9)
    const word = { within: 'Within', under: 'Under', over: 'Over' }[weighing.outcome]
    await becomes(() => page.locator('.verdict .badge').textContent(), word)
    await page.getByText('Table of Mass in the vial').click()
    // With no negative zero.
    await becomes(async () => (await csvEqualsTable('Mass in the vial')).slice(1).map(([, mass]) => Number(mass)), ticks.map((t) => t.reading.mass_mg + 0))
    await becomes(async () => (await csvEqualsTable('Steps')).length - 1, ticks.length)
    await page.getByText('Target 12.00 mg').waitFor()
  })

  it('is refused beside the field when no spoon holds the target, and nothing is stored', async () => {
    const before = (await service.get('/v1/weighings')).items.length
    await chromium.open(page, 'weighings')
    await unlock(page, service.token)
    const form = await openPanel(page, 'Weigh a dose')
    await form.getByLabel('Powder', { exact: true }).selectOption('sand')
    await form.getByLabel('Target').fill('9000')
    await form.getByRole('button', { name: 'Weigh' }).click()
    await page.getByRole('alert').waitFor()
    await becomes(() => form.getByLabel('Target').getAttribute('aria-invalid'), 'true')
    assert.equal((await service.get('/v1/weighings')).items.length, before)
  })

  it('is stopped by the button', async () => {
    await chromium.open(page, 'weighings')
    await unlock(page, service.token)
    // The last waits for the others, which gives time to press the button.
    const ask = (key) => service.post('/v1/weighings', { powder: 'sand', target: { value: 12, unit: 'mg' }, tolerance: { lower: 1, upper: 1, unit: 'mg' }, policy: made.policy }, { 'idempotency-key': key })
    for (const key of ['goes-first', 'goes-second', 'goes-third']) await ask(key)
    const { id } = await ask('to-be-stopped')
    await chromium.open(page, `weighings/${id}`)
    await page.getByRole('button', { name: 'Stop before it starts' }).click()
    await page.locator('.verdict').getByText('Stopped').waitFor({ timeout: 120_000 })
    assert.equal((await service.get(`/v1/weighings/${id}`)).weighing.outcome, 'stopped')
  })

  it('is listed newest first; order and filter live in the address', async () => {
    await chromium.open(page, 'weighings')
    await csvEqualsTable('Weighings')
    await table('Weighings').getByRole('button', { name: 'Target (mg)' }).click()
    await page.getByLabel('Outcome').selectOption('stopped')
    await page.waitForURL(/sort=target/)
    await page.waitForURL(/outcome=stopped/)
    await page.reload()
    await row('Weighings', 'Stopped').waitFor()
    await holds(async () => assert.ok((await tableCells(table('Weighings'))).slice(1).every((c) => c[1] === 'Stopped')))
    await becomes(() => table('Weighings').getByRole('columnheader', { name: 'Target (mg)' }).getAttribute('aria-sort'), 'descending')
  })

  it('is found among all by what is asked for, with a count, and the CSV holds every match', async () => {
    await chromium.open(page, 'weighings')
    await unlock(page, service.token)
    const ask = (key, asked, value) =>
      service.post('/v1/weighings', { powder: 'sand', target: { value, unit: 'mg' }, tolerance: { lower: 1, upper: 1, unit: 'mg' }, policy: made.policy, asked }, { 'idempotency-key': key })
    const doses = [await ask('found-1', { lot: 'B-77', vial: 'V1', operator: 'Ada' }, 6), await ask('found-2', { lot: 'B-77', vial: 'V2', operator: 'Bo' }, 9), await ask('found-3', { lot: 'C-1' }, 7)]
    // A row that still changes would not equal its line of the CSV.
    const ends = async ({ id }) => {
      while (!(await service.get(`/v1/weighings/${id}`)).weighing.outcome) await new Promise((done) => setTimeout(done, 200))
    }
    await Promise.all(doses.map(ends))
    await page.getByLabel('Lot').last().fill('B-77')
    await page.keyboard.press('Enter')
    await page.getByRole('status').getByText('2 match').waitFor()
    await table('Weighings').getByRole('button', { name: 'Target (mg)' }).click()
    await page.waitForURL(/lot=B-77/)
    await page.waitForURL(/sort=target/)
    await holds(async () => {
      const cells = await tableCells(table('Weighings'))
      const column = (name) => cells[0].findIndex((text) => text.startsWith(name))
      assert.deepEqual(cells.slice(1).map((row) => [row[column('Target')], row[column('Vial')]]), [['9.00', 'V2'], ['6.00', 'V1']])
    })
    await becomes(async () => (await csvEqualsTable('Weighings')).length, 3)
    await page.getByLabel('Search').fill('bo v2')
    await page.keyboard.press('Enter')
    await page.getByRole('status').getByText('1 match').waitFor()
    const day = (days) => new Date(Date.now() + days * 86_400_000).toISOString().slice(0, 10)
    await page.getByLabel('From').fill(day(2))
    await page.getByText('No weighing matches.').waitFor()
    await page.getByRole('button', { name: 'Show all' }).click()
    await page.getByRole('status').getByText(/in all/).waitFor()
  })
})

describe('jobs', () => {
  it('are watched live and cancelled, and the cancellation is announced', async () => {
    await chromium.open(page, 'jobs?kind=calibration')
    await unlock(page, service.token)
    const { id } = await service.post('/v1/calibrations', { powder: 'semolina', method: 'sequential', sets: 50, tolerance_deg: 0.1, trials_max: 500 })
    const name = new RegExp(`Cancel Calibration ${id.slice(-8)}`)
    await row('Jobs', id.slice(-8)).getByText('Running').waitFor({ timeout: 120_000 })
    await page.getByRole('button', { name }).click()
    await row('Jobs', id.slice(-8)).getByText('Cancelled').waitFor({ timeout: 120_000 })
    assert.equal((await service.get(`/v1/jobs/${id}`)).state, 'cancelled')
    await page.locator('[aria-live=polite]').getByText(new RegExp(`${id.slice(-8)}: Cancelled`)).waitFor()
    await csvEqualsTable('Jobs')
  })
})

describe('every view', () => {
  const views = () => ({
    console: '',
    overview: 'story',
    powders: 'powders',
    powder: 'powders/sand',
    calibration: `calibrations/${made.sugar.id}`,
    trainings: 'trainings',
    training: `trainings/${made.training.id}`,
    policies: 'policies',
    policy: `policies/${made.policy}`,
    evaluation: `evaluations/${made.evaluation.id}`,
    weighings: 'weighings',
    bench: 'bench',
    investigations: 'investigations',
    simulators: 'simulators',
    weighing: `weighings/${made.weighing}`,
    jobs: 'jobs',
  })

  for (const scheme of ['light', 'dark']) {
    it(`has no fault that axe finds, in the ${scheme} theme`, async () => {
      await page.emulateMedia({ colorScheme: scheme })
      const faults = []
      for (const [name, hash] of Object.entries(views())) {
        await chromium.open(page, hash)
        await page.locator('.sheet').first().waitFor()
        await page.evaluate(() => document.fonts.ready)
        await picture(page, `${name}-${scheme}`)
        faults.push(...(await accessibilityFaults(page)).map((fault) => `${name}: ${fault}`))
      }
      assert.deepEqual(faults, [])
    })
  }

  for (const [width, height] of [[1440, 900], [390, 844]]) {
    it(`explains every heading and column that names a term, by the keyboard, at ${width} px`, async () => {
      await page.setViewportSize({ width, height })
      const missing = []
      for (const [name, hash] of Object.entries(views())) {
        await chromium.open(page, hash)
        await page.locator('.sheet').first().waitFor()
        await page.waitForTimeout(700)
        missing.push(...(await unexplained(page)).map((what) => `${name}: ${what}`))
        for (const [word, { text, within }] of await explanations(page)) if (text.length < 12 || !within) missing.push(`${name}: ${word} says “${text}”${within ? '' : ', out of the window'}`)
      }
      await page.setViewportSize({ width: 1400, height: 900 })
      assert.deepEqual(missing, [])
    })
  }

  it('shows every column of its tables at 1280 px, and says so where there is no room', async () => {
    const cut = () => page.locator('main [role=region]:visible').evaluateAll((regions) => regions.filter((it) => it.scrollWidth > it.clientWidth + 2).map((it) => `${it.ariaLabel}, ${it.scrollWidth - it.clientWidth} px`))
    await page.setViewportSize({ width: 1280, height: 800 })
    const found = []
    for (const [name, hash] of Object.entries(views())) {
      await chromium.open(page, hash)
      await page.locator('.sheet').first().waitFor()
      await page.waitForTimeout(500)
      await becomes(cut, []).catch((error) => found.push(`${name}: ${error.message}`))
    }
    assert.deepEqual(found, [])
    await page.setViewportSize({ width: 390, height: 844 })
    await chromium.open(page, 'weighings')
    await page.getByText('There are more columns than fit').waitFor()
    await page.setViewportSize({ width: 1400, height: 900 })
  })

  it('fits a narrow window without scrolling sideways', async () => {
    await page.setViewportSize({ width: 400, height: 800 })
    const wide = []
    for (const [name, hash] of Object.entries(views())) {
      await chromium.open(page, hash)
      await page.locator('.sheet').first().waitFor()
      if (!(await fits(page))) wide.push(name)
    }
    await page.setViewportSize({ width: 1400, height: 900 })
    assert.deepEqual(wide, [])
  })

  it('can be reached from the keyboard alone', async () => {
    await chromium.open(page)
    await page.keyboard.press('Tab')
    await becomes(() => page.evaluate(() => document.activeElement.textContent), 'Skip to content')
    const focused = () => page.evaluate(() => document.activeElement.textContent.trim())
    for (let k = 0; k < 20 && (await focused()) !== 'Powders'; k++) await page.keyboard.press('Tab')
    assert.equal(await focused(), 'Powders')
    await page.keyboard.press('Enter')
    await page.getByRole('heading', { name: 'Powders', level: 1 }).waitFor()
    await becomes(() => page.evaluate(() => document.activeElement.id), 'main')
  })

  it('does not move for who asks for less motion', async () => {
    await page.emulateMedia({ reducedMotion: 'reduce' })
    await chromium.open(page, 'jobs')
    await page.getByRole('progressbar').first().waitFor()
    await becomes(() => page.locator('.eases').first().evaluate((bar) => getComputedStyle(bar).transitionDuration), '0s')
    await page.emulateMedia({ reducedMotion: null })
  })

  it('writes times in the local zone with ISO 8601 behind them', async () => {
    const abroad = await chromium.tab({ timezoneId: 'Asia/Tokyo', locale: 'en-GB' })
    await chromium.open(abroad, 'jobs')
    const time = abroad.locator('table time').first()
    await time.waitFor()
    const [iso, title, text] = await time.evaluate((t) => [t.dateTime, t.title, t.textContent])
    assert.equal(title, iso)
    const hour = String((new Date(iso).getUTCHours() + 9) % 24).padStart(2, '0')
    assert.ok(text.includes(` ${hour}:`), `${iso} is written as ${text} in Tokyo`)
    await abroad.context().close()
  })

  it('says what is wrong when there is no such thing', async () => {
    const stranger = await chromium.tab()
    await chromium.open(stranger, 'powders/unobtainium')
    await stranger.getByRole('alert').getByText(/unobtainium/).waitFor()
    await stranger.context().close()
  })

  it('kept to the strict content security policy and to this host', async () => {
    const policy = (await fetch(service.url)).headers.get('content-security-policy')
    assert.match(policy, /default-src 'self'/)
    assert.ok(!policy.includes('unsafe'), policy)
    assert.deepEqual(chromium.complaints, [])
  })
})
