/** The stop of the bench or of one weighing: sent immediately, once, and never resent automatically. */
import { giveWay } from './api/gate'
import { Problem } from './api/problem'
import { t } from './language.svelte'
import { settings } from './settings.svelte'

/** No response within this time counts as not sent. */
const ANSWER_MS = 2000

type Phase = 'idle' | 'sending' | 'stopped' | 'not sent'

export class Stop {
  phase = $state<Phase>('idle')
  /** From the press to the response. */
  ms = $state(0)
  /** Why it was not sent. */
  why = $state('')

  constructor(private readonly address: string) {}

  press = async (): Promise<void> => {
    if (this.phase === 'sending') return
    if (!settings.token) return void (settings.asksForToken = true)
    this.phase = 'sending'
    const pressed = performance.now()
    const late = new AbortController()
    const timer = setTimeout(() => late.abort(), ANSWER_MS)
    const sent = giveWay()
    try {
      const response = await fetch(this.address, {
        method: 'POST',
        headers: { authorization: `Bearer ${settings.token}` },
        cache: 'no-store',
        priority: 'high',
        keepalive: true,
        signal: late.signal,
      })
      if (!response.ok) this.#failed(await reason(response))
      else {
        this.ms = performance.now() - pressed
        this.phase = 'stopped'
      }
    } catch {
      this.#failed(late.signal.aborted ? t('No response within {s} s.', { s: ANSWER_MS / 1000 }) : t('The service is not responding.'))
    }
    clearTimeout(timer)
    sent()
  }

  /** The result of the last press has been read, or is out of date. */
  forget = () => {
    if (this.phase !== 'sending') this.phase = 'idle'
  }

  #failed(why: string) {
    this.why = why
    this.phase = 'not sent'
  }
}

/** Why the service, or a machine in front of it, refused. */
async function reason(response: Response): Promise<string> {
  const { title, detail } = Problem.from(await response.json().catch(() => undefined), response)
  return detail ? `${title}: ${detail}` : `${title}.`
}

/** Stops anything that moves. */
export const benchStop = new Stop('/v1/bench/stop')

export const weighingStop = (id: string) => new Stop(`/v1/weighings/${encodeURIComponent(id)}/stop`)
