// A small stand-in for the service while it is being written.
import { createServer } from 'node:http'
import { readFile } from 'node:fs/promises'
import { extname } from 'node:path'
const t0 = Date.parse('2026-11-21T07:30:00Z')
const iso = (s) => new Date(t0 + s * 1000).toISOString()
let r = 12345
const rnd = () => ((r = (r * 1103515245 + 12345) & 0x7fffffff) / 0x7fffffff)
const gauss = () => Math.sqrt(-2 * Math.log(rnd() + 1e-9)) * Math.cos(2 * Math.PI * rnd())
const P = [['sand', 'Sand', 28.55, 1.94, 27.69, 2.54], ['sugar', 'Sugar', 31.41, 1.42, 30.93, 0.87], ['salt', 'Salt', 36.03, 2.29, 35.8, 1.71], ['semolina', 'Semolina', 42.762, 1.97, 40.91, 1.85], ['sodium_bicarbonate', 'Sodium bicarbonate', 42.38, 2.48, 43.14, 1.0]]
const params = () => ({ particle_diameter_mm: 0.22 + 0.1 * rnd(), adhesion: 1.3 * rnd(), particle_adhesion_scale: 1.3 * rnd(), adhesion_offset_scale: 5e-5 * rnd(), friction: 1.3 * rnd(), gravity_scale: 0.3 + 0.8 * rnd(), damping: rnd(), cohesion: 1.2 * rnd(), particle_mass_ug: 13 + 3.5 * rnd() })
const uuid = (k) => `01939a${(k + 16).toString(16)}-7c3e-7b1a-9f21-${(0xabc000000000 + k * 7919).toString(16)}`
const job = (id, kind, state, f, msg, at) => ({ id, kind, state, progress: { fraction: f, message: msg }, attempts: state === 'queued' ? 0 : 1, cancelling: false, created_at: iso(at), started_at: state === 'queued' ? null : iso(at + 2), finished_at: ['succeeded', 'failed', 'cancelled'].includes(state) ? iso(at + 92) : null, error: state === 'failed' ? 'only 3 of 10 sets found within 1.5 deg in 150 trials' : null })
const powders = P.map(([id, name, a, s]) => ({ id, name, flowability: { repose_deg: a, sd_deg: s, n: 5 }, created_at: iso(0) }))
const calibrations = P.map(([id, , a, s], k) => {
  const sets = Array.from({ length: 10 }, (_, j) => { const v = a + (rnd() - 0.5) * 2.6; return { id: `ps-${(0x1a2b3c4d5e6f7 + k * 977 + j * 131071).toString(16).padStart(16, '0')}`, parameters: params(), repose_deg: v, repose_sd_deg: 0.3 + rnd() * 0.5, runs: 3, error_deg: Math.abs(v - a) } })
  const e = sets.map((x) => x.error_deg)
  return { job: job(uuid(k), 'calibration', 'succeeded', 1, 'done', 10 + k * 100), powder: id, target: { repose_deg: a, sd_deg: s, n: 5 }, settings: { sets: 10, tolerance_deg: 1.5, trials_max: 150, initial: 24, batch: 4, seed: 1, repose: { particles: 2000 } }, result: { evaluations: 64, verification_runs: 24, sets, mean_error_deg: e.reduce((a, b) => a + b) / 10, sd_error_deg: 0.41 } }
})
const trials = (c) => Array.from({ length: 88 }, (_, i) => { const s = i >= 64; const ref = !s && rnd() < 0.05; const tip = s ? c.target.repose_deg + gauss() * 0.9 : c.target.repose_deg + gauss() * 9 * Math.exp(-i / 22) + gauss() * 1; return { index: i, phase: s ? 'verification' : 'search', parameters: params(), seed: i, tip_deg: ref ? null : tip, cone_deg: ref ? null : tip - 2, creep_deg_per_s: 0.01, refusal: ref ? 'the pile covers 5 of 16 sectors' : null, error_deg: ref ? null : Math.abs(tip - c.target.repose_deg) } })
const details = P.map(([id, , a, s, b, t], k) => ({ powder: powders[k], measurements: [{ id: `m${k}a`, powder: id, method: 'automated', repose_deg: a, sd_deg: s, n: 5, source: 'arXiv:2506.03896', created_at: iso(0) }, { id: `m${k}b`, powder: id, method: 'manual', repose_deg: b, sd_deg: t, n: 5, source: 'arXiv:2506.03896', created_at: iso(0) }], sets: calibrations[k].result.sets.map((x) => ({ ...x, powder: id, calibration: calibrations[k].job.id, created_at: iso(100 + k * 100) })) }))
const levels = P.slice(0, 3).map(([id, , a], k) => ({ powder: id, repose_deg: a, sets: calibrations[k].result.sets.slice(0, 7).map((s) => s.id) }))
const T = uuid(40)
const training = { job: job(T, 'training', 'succeeded', 1, 'done', 520), order: 'curriculum', preset: 'flip', episodes: 600, levels, settings: { seed: 1, learning_rate: 0.0003, gamma: 0.99, curriculum: { queue: 20, mean_mg: 0.8 } }, result: { policy: 'p-3f9a1c5be2d7840f', episodes: 600, final_error_mg: 0.92, levels: [] } }
const episodes = Array.from({ length: 600 }, (_, i) => { const e = Math.abs(9 * Math.exp(-i / 110) * rnd() + 0.9 * gauss()) + (i > 240 && i < 280 ? rnd() * 3 : 0) + (i > 420 && i < 450 ? rnd() * 2 : 0); return { index: i, level: i < 240 ? 0 : i < 420 ? 1 : 2, powder: P[i < 240 ? 0 : i < 420 ? 1 : 2][0], target_mg: 5 + 10 * rnd(), final_error_mg: e, reward: 4 - e * 3 + gauss(), steps: 6, alpha: 0.2 * Math.exp(-i / 200) + 0.01, critic_loss: 0.4, actor_loss: -0.3 } })
const manifest = { kind: 'learned', widths: [3, 64, 64, 4], preset: 'flip', seed: 1, code_version: '0.1.0', simulator_version: 'pbd-1', rules: { steps_max: 10, ending: 'near_target' }, levels: levels.map((l, k) => ({ powder: l.powder, repose_deg: l.repose_deg, episodes: [240, 180, 180][k], sets: l.sets.map((id) => ({ id, parameters: params() })) })), switches: [{ episode: 240, from: 0, to: 1, reason: 'mean' }, { episode: 420, from: 1, to: 2, reason: 'time_out' }], episodes: 600, final_error_mg: 0.92, settings: training.settings }
const policy = { id: 'p-3f9a1c5be2d7840f', kind: 'learned', training: T, manifest, sha256: '3f9a1c5be2d7840f'.repeat(4), size_bytes: 19344, evaluated: P.map(([id]) => ({ powder: id, mae_mg: 0.6 + rnd(), n: 10 })), created_at: iso(700) }
const E = uuid(50)
const erow = []
for (const [c, m] of [['policy', 0.9], ['untrained', 9], ['fixed', 4.2], ['schedule', 2.1]]) for (const [p] of P) for (const t of [15, 20]) erow.push({ controller: c, powder: p, target_mg: t, n: 5, mae_mg: m * (0.7 + rnd() * 0.6), sd_mg: m * 0.8, bias_mg: (rnd() - 0.6) * m, over_share: Math.round(rnd() * 5) / 5, zero_share: 0, shakes_mean: 4 + rnd() * 5 })
const evaluation = { job: job(E, 'evaluation', 'succeeded', 1, 'done', 800), policy: policy.id, controllers: ['policy', 'untrained', 'fixed', 'schedule'], powders: P.map((p) => p[0]), targets_mg: [15, 20], repeats: 5, readability_mg: 1, max_shakes: 10, seed: 1, result: { rows: erow, summary: [['policy', 0.91], ['untrained', 8.8], ['fixed', 4.3], ['schedule', 2.2]].map(([controller, mae_mg]) => ({ controller, mae_mg, ci95: [mae_mg * 0.8, mae_mg * 1.25], sd_trials_mg: mae_mg * 0.7, sd_within_cells_mg: mae_mg * 0.5 })) } }
const ticksFor = (d, target) => { const n = 7; const ticks = [{ step: 0, t_s: 2, pitch_deg: 0, action: { incline_change_deg: 0, shake_mm: 0 }, reading: { mass_mg: 0, stable: true } }]; for (let i = 1; i <= n; i++) ticks.push({ step: i, t_s: 2 + i * 4.3, pitch_deg: Math.min(36, i * 6.3), action: { incline_change_deg: 6.3 - (i > 5 ? 6 : 0), shake_mm: i < 2 ? 0 : 3 + 8 * rnd() }, reading: { mass_mg: Math.round(d * Math.min(1, (i / n) ** 1.3)), stable: true } }); return ticks }
const weighings = P.map(([id], k) => { const e = [0.42, -0.31, 1.84, -1.46, 0.12][k]; return { id: uuid(60 + k), powder: id, target_mg: 15, tolerance_lower_mg: 1, tolerance_upper_mg: 1, policy: policy.id, parameter_set: details[k].sets[8].id, seed: 17 + k, state: 'done', outcome: e > 1 ? 'over' : e < -1 ? 'under' : 'within', dispensed_mg: 15 + e, reading_mg: Math.round(15 + e), error_mg: e, shakes: 6, seconds: 31.2, error: null, created_at: iso(900 + k * 40), started_at: iso(901 + k * 40), finished_at: iso(932 + k * 40) } }).reverse()
const ticks = Object.fromEntries(weighings.map((w) => [w.id, ticksFor(w.dispensed_mg, 15)]))
const running = job(uuid(70), 'training', 'running', 0.37, 'episode 148 of 400, level 1 of 3', 1000)
const jobs = [running, job(uuid(71), 'calibration', 'queued', 0, '', 1010), evaluation.job, training.job, ...calibrations.map((c) => c.job).reverse(), job(uuid(72), 'calibration', 'failed', 0.9, 'trial 150', 3)]
const streams = new Set()
let seq = 0
const emit = (topic, kind, data) => { const e = { seq: ++seq, topic, kind, data, at: new Date().toISOString() }; for (const s of streams) s.write(`id: ${e.seq}\nevent: ${kind}\ndata: ${JSON.stringify(e)}\n\n`) }
setInterval(() => { if (running.state === 'running') { running.progress = { fraction: Math.min(0.99, running.progress.fraction + 0.01), message: `episode ${Math.round(400 * running.progress.fraction)} of 400, level 1 of 3` }; emit(`job:${running.id}`, 'progress', running.progress) } }, 1500)
const TYPES = { '.html': 'text/html', '.js': 'text/javascript', '.css': 'text/css', '.svg': 'image/svg+xml', '.woff2': 'font/woff2' }
const page = (items) => ({ items, next: null })
createServer(async (req, res) => {
  const url = new URL(req.url, 'http://x')
  const parts = url.pathname.split('/').filter(Boolean)
  const send = (body, status = 200) => { res.writeHead(status, { 'content-type': status < 400 ? 'application/json' : 'application/problem+json' }); res.end(JSON.stringify(body)) }
  const missing = () => send({ type: 'urn:flip:problem:not-found', title: 'Not found', status: 404, detail: 'there is no such thing', errors: [] }, 404)
  if (parts[0] !== 'v1') {
    const file = url.pathname === '/' ? '/index.html' : url.pathname
    try { const body = await readFile(new URL('../dist' + file, import.meta.url)); res.writeHead(200, { 'content-type': TYPES[extname(file)] ?? 'application/octet-stream', 'content-security-policy': "default-src 'self'" }); return res.end(body) } catch { return missing() }
  }
  if (req.method === 'POST') {
    if (!req.headers.authorization) return send({ title: 'A valid token is needed', status: 401, detail: 'give a token', errors: [] }, 401)
    let text = ''; for await (const c of req) text += c
    const body = text ? JSON.parse(text) : {}
    if (parts[1] === 'weighings' && !parts[2]) {
      if (!(body.target.value > 0)) return send({ title: 'The request is not valid', status: 400, detail: 'target.value must be a number from 0.1 to 30 mg', errors: [{ field: 'target.value', message: 'must be from 0.1 to 30 mg' }] }, 400)
      const id = uuid(80 + weighings.length)
      const w = { ...weighings[0], id, powder: body.powder, target_mg: body.target.value, state: 'dosing', outcome: null, dispensed_mg: null, reading_mg: null, error_mg: null, shakes: null, seconds: null, finished_at: null, created_at: new Date().toISOString() }
      weighings.unshift(w); ticks[id] = []
      const full = ticksFor(w.target_mg + 0.4, w.target_mg)
      full.forEach((t, k) => setTimeout(() => { ticks[id].push(t); emit(`weighing:${id}`, 'tick', t) }, 300 * k))
      setTimeout(() => { Object.assign(w, { state: 'done', outcome: 'within', dispensed_mg: w.target_mg + 0.4, reading_mg: Math.round(w.target_mg), error_mg: 0.4, shakes: 6, seconds: 32, finished_at: new Date().toISOString() }); emit(`weighing:${id}`, 'state', { state: 'done', outcome: 'within' }) }, 3000)
      return send(w, 202)
    }
    if (parts[1] === 'jobs' && parts[3] === 'cancel') { const j = jobs.find((x) => x.id === parts[2]); j.state = 'cancelled'; j.finished_at = new Date().toISOString(); emit(`job:${j.id}`, 'state', { state: 'cancelled', kind: j.kind }); return send(j) }
    return send(jobs[1], 202)
  }
  const [, what, id, sub] = parts
  const one = (list, key = (x) => x.id) => list.find((x) => key(x) === id)
  const found = (x) => (x ? send(x) : missing())
  if (what === 'events') { res.writeHead(200, { 'content-type': 'text/event-stream' }); res.write(':\n\n'); streams.add(res); return req.on('close', () => streams.delete(res)) }
  if (what === 'powders') return id ? found(one(details, (d) => d.powder.id)) : send(page(powders))
  if (what === 'calibrations') return sub ? send(page(trials(one(calibrations, (c) => c.job.id)))) : id ? found(one(calibrations, (c) => c.job.id)) : send(page([...calibrations].reverse()))
  if (what === 'trainings') return sub ? send(page(episodes)) : id ? found(id === T ? training : { ...training, job: running, result: null }) : send(page([{ ...training, job: running, result: null }, training]))
  if (what === 'policies') return id ? found(policy) : send(page([policy]))
  if (what === 'evaluations') return id ? found(evaluation) : send(page([evaluation]))
  if (what === 'weighings') return id ? found(one(weighings) && { weighing: one(weighings), ticks: ticks[id] }) : send(page(weighings))
  if (what === 'jobs') return id ? found(one(jobs)) : send(page(jobs.filter((j) => (!url.searchParams.get('kind') || j.kind === url.searchParams.get('kind')) && (!url.searchParams.get('state') || j.state === url.searchParams.get('state')))))
  missing()
}).listen(Number(process.env.PORT ?? 8099), '127.0.0.1')
