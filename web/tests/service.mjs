/** A real `flip serve` on a fresh data folder, and a client that asks it what the page should show. */
import { spawn } from 'node:child_process'
import { mkdtempSync, rmSync, existsSync } from 'node:fs'
import { tmpdir } from 'node:os'
import { join, resolve } from 'node:path'
import { fileURLToPath } from 'node:url'
import { startFront } from './front.mjs'

const BINARY = process.env.FLIP_BIN ?? fileURLToPath(new URL('../../target/release/flip', import.meta.url))

/** An emulated laboratory that lives until it is stopped, and the bench file that finds it. */
export async function startLab(...more) {
  const folder = mkdtempSync(join(tmpdir(), 'flip-lab-'))
  const file = join(folder, 'bench.toml')
  const child = spawn(BINARY, ['emulate', 'lab', '--json', '--formula', '--out', file, ...more], { stdio: ['ignore', 'pipe', 'inherit'] })
  const exited = new Promise((resolve) => child.once('exit', resolve))
  await Promise.race([new Promise((resolve) => child.stdout.once('data', resolve)), exited])
  if (child.exitCode !== null) throw new Error('flip emulate lab does not begin')
  const stop = async () => {
    child.kill('SIGTERM')
    await exited
    rmSync(folder, { recursive: true, force: true })
  }
  return { file, stop }
}

/** With these arguments beside those of every test's. */
export async function startService(...more) {
  if (!existsSync(BINARY)) throw new Error(`no binary at ${BINARY}: run cargo build --release, or set FLIP_BIN`)
  const folder = mkdtempSync(join(tmpdir(), 'flip-page-'))
  const child = spawn(BINARY, ['serve', '--json', '--listen', '127.0.0.1:0', '--data-dir', join(folder, 'data'), ...more], { stdio: ['ignore', 'pipe', 'pipe'] })
  let log = ''
  child.stderr.on('data', (text) => (log = (log + text).slice(-8000)))
  let said = ''
  child.stdout.on('data', (text) => (said += text))
  const exited = new Promise((resolve) => child.once('exit', resolve))
  let front
  const stop = async () => {
    await front?.stop()
    child.kill('SIGTERM')
    const hard = setTimeout(() => child.kill('SIGKILL'), 20_000)
    await exited
    clearTimeout(hard)
    rmSync(folder, { recursive: true, force: true })
  }

  // It says where it listens, and the token of the first start, as one JSON document.
  for (let k = 0; !said.includes('}'); k++) {
    if (k > 600 || child.exitCode !== null) {
      await stop()
      throw new Error(`flip serve does not begin\n${log}`)
    }
    await new Promise((resolve) => setTimeout(resolve, 100))
  }
  const { url: own, token } = JSON.parse(said)
  // FLIP_PAGE: a page built since, without building the binary again.
  front = process.env.FLIP_PAGE ? await startFront(own, { folder: resolve(process.env.FLIP_PAGE), docs: resolve(process.env.FLIP_PAGE, '../docs-dist') }) : undefined
  const url = front ? front.url : own

  /** One call; refuses anything but 2xx. */
  async function ask(method, path, body, headers = {}) {
    const response = await fetch(url + path, {
      method,
      headers: { authorization: `Bearer ${token}`, ...(body ? { 'content-type': 'application/json' } : {}), ...headers },
      body: body && JSON.stringify(body),
    })
    const text = await response.text()
    if (!response.ok) throw new Error(`${method} ${path}: ${response.status} ${text}\n${log}`)
    return JSON.parse(text)
  }
  const get = (path) => ask('GET', path)
  const post = (path, body, headers) => ask('POST', path, body, headers)
  const put = (path, body) => ask('PUT', path, body)

  /** The job once it has ended well. */
  async function finished(id, seconds = 400) {
    for (let k = 0; k < seconds * 5; k++) {
      const job = await get(`/v1/jobs/${id}`)
      if (job.state === 'succeeded') return job
      if (job.state === 'failed' || job.state === 'cancelled') throw new Error(`job ${id} ${job.state}: ${job.error}\n${log}`)
      await new Promise((resolve) => setTimeout(resolve, 200))
    }
    throw new Error(`job ${id} is not done after ${seconds} s\n${log}`)
  }

  return { url, own, token, folder: join(folder, 'data'), get, post, put, finished, stop, kill: () => child.kill('SIGKILL') }
}
