/** How a tab gets its events: from the browser's one worker, otherwise from the leading tab, otherwise by itself. */
import { Hub, type Said, type Told } from './hub'

type Say = (said: Said) => void
type Hear = (told: Told) => void

/** A worker answers within this time. */
const WORKER_MS = 4000

/** Returns the function to send messages; received messages go to `hear`. */
export function link(hear: Hear): Say {
  if (typeof SharedWorker !== 'undefined') return shared(hear)
  return without(hear)
}

function without(hear: Hear): Say {
  // Locks exist only under TLS and on loopback.
  return typeof BroadcastChannel !== 'undefined' && navigator.locks ? led(hear) : alone(hear)
}

function shared(hear: Hear): Say {
  const { port } = new SharedWorker(new URL('./shared.ts', import.meta.url), { type: 'module', name: 'flip-events' })
  let last: Said = { kind: 'gone' }
  let instead: Say | undefined
  let timer: ReturnType<typeof setTimeout> | undefined
  // A worker that cannot be loaded or has died is not always reported, so one that does not answer counts as lost.
  const help = () => {
    port.onmessage = null
    port.postMessage({ kind: 'gone' } satisfies Said)
    port.close()
    instead = without(hear)
    instead(last)
  }
  port.onmessage = ({ data }: MessageEvent<Told>) => {
    clearTimeout(timer)
    timer = undefined
    hear(data)
  }
  return (said) => {
    last = said
    if (instead) return instead(said)
    port.postMessage(said)
    if (said.kind === 'here') timer ??= setTimeout(help, WORKER_MS)
  }
}

function alone(hear: Hear): Say {
  const hub = new Hub()
  const tab = { tell: hear }
  return (said) => hub.hear(tab, said)
}

/** Of the visible tabs with the same token, one holds the lock and with it the stream, and passes events to the others. */
function led(hear: Hear): Say {
  let leave = () => {}
  let joined: string | undefined
  let lead: Say | undefined
  return (said) => {
    const token = said.kind === 'here' && said.visible ? said.token : undefined
    if (token === joined) return lead?.(said)
    leave()
    joined = token
    if (token === undefined) return
    const left = new AbortController()
    // Names of channels and locks are visible to this origin only.
    const name = `flip-events ${token}`
    const channel = new BroadcastChannel(name)
    let open: Told | undefined
    const tell: Hear = (told) => {
      if (told.kind === 'open') open = told
      hear(told)
      channel.postMessage(told)
    }
    channel.onmessage = ({ data }: MessageEvent<Told | 'open?'>) => {
      if (data !== 'open?') hear(data)
      else if (lead && open) channel.postMessage(open)
    }
    channel.postMessage('open?')
    const hub = new Hub()
    navigator.locks
      .request(name, { signal: left.signal }, () => {
        const tab = { tell }
        lead = (said) => hub.hear(tab, said)
        lead(said)
        return new Promise<void>((done) => left.signal.addEventListener('abort', () => done()))
      })
      // Left while waiting for the lock.
      .catch(() => {})
    leave = () => {
      lead = undefined
      hub.close()
      left.abort()
      channel.close()
    }
  }
}
