/** The one worker of all tabs of this browser: it holds the event stream for them. */
import { Hub, type Said, type Told } from './hub'

const hub = new Hub()

// The DOM types do not include SharedWorkerGlobalScope.
const scope = self as unknown as { onconnect: (event: MessageEvent) => void }
scope.onconnect = ({ ports: [port] }) => {
  if (!port) return
  const tab = { tell: (told: Told) => port.postMessage(told) }
  port.onmessage = ({ data }: MessageEvent<Said>) => {
    tab.tell({ kind: 'heard' })
    hub.hear(tab, data)
  }
}
