/** How a tab gets its events: from the browser's one worker, else from the tab that leads, else by itself. */
import { Hub, type Said, type Told } from './hub'

type Say = (said: Said) => void
type Hear = (told: Told) => void

/** The way to speak; what is told comes to `hear`. */
export function link(hear: Hear): Say {
  if (typeof SharedWorker !== 'undefined') return shared(hear)
  return without(hear)
}

function without(hear: Hear): Say {
  // Locks exist under TLS and on loopback only.
  return typeof BroadcastChannel !== 'undefined' && navigator.locks ? led(hear) : alone(hear)
}

function shared(hear: Hear): Say {
  let last: Said | undefined
  const worker = new SharedWorker(new URL('./shared.ts', import.meta.url), { type: 'module', name: 'flip-events' })
  let say: Say = (said) => worker.port.postMessage(said)
  worker.port.onmessage = ({ data }: MessageEvent<Told>) => hear(data)
  // A worker that cannot be loaded leaves the tab to help itself.
  worker.onerror = () => {
    worker.port.close()
    say = without(hear)
    if (last) say(last)
  }
  return (said) => {
    last = said
    say(said)
  }
}

function alone(hear: Hear): Say {
  const hub = new Hub()
  const tab = { tell: hear }
  return (said) => hub.hear(tab, said)
}

/** Of the tabs that can be seen and have the same token one holds the lock, and with it the stream; it tells the others. */
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
    // Names of channels and locks are seen by this origin alone.
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
