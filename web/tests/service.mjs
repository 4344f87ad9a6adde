/** A real `flip serve` on a fresh data folder, and a client that asks it what the page should show. */
import { spawn, execFileSync } from 'node:child_process'
import { mkdtempSync, rmSync, existsSync } from 'node:fs'
import { createServer } from 'node:net'
import { tmpdir } from 'node:os'
import { join } from 'node:path'
import { fileURLToPath } from 'node:url'

const BINARY = process.env.FLIP_BIN ?? fileURLToPath(new URL('../../target/release/flip', import.meta.url))

function freePort() {
  return new Promise((resolve) => {
    const probe = createServer().listen(0, '127.0.0.1', () => {
      const { port } = probe.address()
      probe.close(() => resolve(port))
    })
  })
}

export async function startService() {
  if (!existsSync(BINARY)) throw new Error(`no binary at ${BINARY}: run cargo build --release, or set FLIP_BIN`)
  const folder = mkdtempSync(join(tmpdir(), 'flip-page-'))
  const data = ['--data-dir', join(folder, 'data')]
  const { token } = JSON.parse(execFileSync(BINARY, ['token', 'create', '--role', 'operator', '--json', ...data], { encoding: 'utf8', stdio: ['ignore', 'pipe', 'ignore'] }))
  const port = await freePort()
  const url = `http://127.0.0.1:${port}`
  const child = spawn(BINARY, ['serve', '--listen', `127.0.0.1:${port}`, ...data], { stdio: ['ignore', 'ignore', 'pipe'] })
  let log = ''
  child.stderr.on('data', (text) => (log = (log + text).slice(-8000)))
  const exited = new Promise((resolve) => child.once('exit', resolve))
  const stop = async () => {
    child.kill('SIGTERM')
    const hard = setTimeout(() => child.kill('SIGKILL'), 20_000)
    await exited
    clearTimeout(hard)
    rmSync(folder, { recursive: true, force: true })
  }

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

  /** The job once it has ended well. */
  async function finished(id, seconds = 120) {
    for (let k = 0; k < seconds * 5; k++) {
      const job = await get(`/v1/jobs/${id}`)
      if (job.state === 'succeeded') return job
      if (job.state === 'failed' || job.state === 'cancelled') throw new Error(`job ${id} ${job.state}: ${job.error}\n${log}`)
      await new Promise((resolve) => setTimeout(resolve, 200))
    }
    throw new Error(`job ${id} is not done after ${seconds} s\n${log}`)
  }

  for (let k = 0; ; k++) {
    if (await fetch(`${url}/v1/powders`).then((r) => r.ok, () => false)) break
    if (k > 150 || child.exitCode !== null) {
      await stop()
      throw new Error(`flip serve does not answer\n${log}`)
    }
    await new Promise((resolve) => setTimeout(resolve, 100))
  }
  return { url, token, get, post, finished, stop }
}
