/** Reading gives way to a stop: a browser has six connections to a host, and a stop must not wait for one. */

/** Messages between the tabs of this browser. */
const channel = typeof BroadcastChannel === 'undefined' ? undefined : new BroadcastChannel('flip-stop')
/** Reading waits no longer than this for a stop from another tab, which may have been closed meanwhile. */
const WAIT_MS = 3000

let reads = new AbortController()
let free = Promise.resolve()
let go = () => {}

function hold() {
  go()
  reads.abort()
  reads = new AbortController()
  free = new Promise((resolve) => {
    const timer = setTimeout(resolve, WAIT_MS)
    go = () => {
      clearTimeout(timer)
      resolve()
    }
  })
}

channel?.addEventListener('message', ({ data }: MessageEvent<'stop' | 'sent'>) => (data === 'stop' ? hold() : go()))

/** Aborts all reads in every tab of this browser, so that a connection is free; the returned function lets reading continue. */
export function giveWay(): () => void {
  hold()
  channel?.postMessage('stop')
  return () => {
    go()
    channel?.postMessage('sent')
  }
}

/** The client's fetch. Reads aborted for a stop are repeated after it; writes are sent once. */
export async function gated(request: Request): Promise<Response> {
  if (request.method !== 'GET') return fetch(request)
  for (;;) {
    await free
    const { signal } = reads
    try {
      const response = await fetch(request.clone(), { signal: AbortSignal.any([request.signal, signal]) })
      const empty = response.status === 204 || response.status === 304
      // Read the whole body, so that an abort in the middle of it is noticed here.
      return new Response(empty ? null : await response.arrayBuffer(), response)
    } catch (error) {
      if (!signal.aborted || request.signal.aborted) throw error
    }
  }
}
