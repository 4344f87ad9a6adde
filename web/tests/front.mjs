/** A machine between browser and service, as labs have them: passes everything on, and does to a request what a test asks. */
import { createReadStream, existsSync } from 'node:fs'
import { createServer, request as ask } from 'node:http'
import { extname, join } from 'node:path'

const KINDS = { '.html': 'text/html', '.js': 'text/javascript', '.css': 'text/css', '.svg': 'image/svg+xml', '.woff2': 'font/woff2' }

/**
 * Stands before the service at `target`; with `folder` gives the page's files from there, with `docs` the documentation's if they are built.
 *
 * `does(request)` may say: `'hang'` (never answered, not passed on), `'cut'` (passed on, and the connection cut instead of an
 * answer), `{ status, body, kind }` (answered so, not passed on), the same with `after: true` (passed on, and answered so
 * when the service has done it), or nothing. What came is in `seen`; `open(path)` says how many of a path are open.
 */
export async function startFront(target, { folder, docs, does = () => undefined } = {}) {
  const service = new URL(target)
  const seen = []
  const front = {
    seen,
    does,
    open: (path) => seen.filter((request) => request.path === path && request.open).length,
    count: (method, path) => seen.filter((request) => request.method === method && request.path === path).length,
  }
  const policy = folder && (await fetch(target)).headers.get('content-security-policy')

  function pass(request, answer, given) {
    const { method, url: path, headers } = request
    const on = ask({ host: service.hostname, port: service.port, method, path, headers }, (told) => given(told))
    on.on('error', () => answer.destroy())
    answer.on('close', () => on.destroy())
    request.pipe(on)
  }
  function say(answer, { status, body = '<h1>Bad gateway</h1>', kind = typeof body === 'string' ? 'text/html' : 'application/json' }) {
    answer.writeHead(status, { 'content-type': kind }).end(typeof body === 'string' ? body : JSON.stringify(body))
  }
  function file(name, answer) {
    if (!existsSync(name)) return answer.writeHead(404).end()
    answer.writeHead(200, { 'content-type': KINDS[extname(name)] ?? 'application/octet-stream', 'content-security-policy': policy })
    createReadStream(name).pipe(answer)
  }

  const server = createServer((request, answer) => {
    const path = request.url.split('?')[0]
    const came = { method: request.method, path, key: request.headers['idempotency-key'], token: request.headers.authorization, open: true }
    seen.push(came)
    answer.on('close', () => (came.open = false))
    const wanted = front.does(came)
    if (wanted === 'hang') return
    if (wanted && wanted !== 'cut' && !wanted.after) return say(answer, wanted)
    if (!wanted && folder && (path === '/' || /^\/(assets\/|mark)/.test(path))) return file(join(folder, path === '/' ? 'index.html' : path), answer)
    if (!wanted && docs && path.startsWith('/docs/') && existsSync(join(docs, path.slice(6)))) return file(join(docs, path.slice(6)), answer)
    pass(request, answer, (told) => {
      if (wanted) {
        told.resume()
        return told.on('end', () => (wanted === 'cut' ? answer.destroy() : say(answer, wanted)))
      }
      answer.writeHead(told.statusCode, told.headers).flushHeaders()
      told.pipe(answer)
    })
  })
  await new Promise((resolve) => server.listen(0, '127.0.0.1', resolve))
  front.url = `http://127.0.0.1:${server.address().port}`
  front.stop = () => {
    server.closeAllConnections()
    return new Promise((resolve) => server.close(resolve))
  }
  return front
}
