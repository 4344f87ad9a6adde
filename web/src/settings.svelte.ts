/** This user's settings: the token (this tab, or this browser if wanted) and the theme (this browser). */
import type { Problem } from './api/problem'
import type { Identity } from './api/types'

const TOKEN = 'flip-token'
const HOLDER = 'flip-holder'
const THEME = 'flip-theme'

export type Theme = 'system' | 'light' | 'dark'

/** What the service reported about the token. */
export type Holder = Identity

/** Where the token is kept: the tab's place comes first. */
const places = () => [sessionStorage, localStorage]
const kept = (key: string) => places().map((place) => place.getItem(key)).find((text) => text) ?? ''

function holder(): Holder | undefined {
  try {
    return (JSON.parse(kept(HOLDER) || 'null') as Holder | null) ?? undefined
  } catch {
    return undefined
  }
}

class Settings {
  #token = $state(kept(TOKEN))
  #holder = $state.raw(holder())
  #theme = $state<Theme>((localStorage.getItem(THEME) as Theme | null) ?? 'system')
  /** True while the token dialog is open. */
  asksForToken = $state(false)
  /** Why a log-in failed, for the dialog when it opens. */
  refusal: Problem | undefined

  constructor() {
    document.documentElement.dataset.theme = this.#theme
  }

  /** The API token, or an empty string: then the page is read-only. */
  get token() {
    return this.#token
  }
  /** Who holds the token. */
  get holder() {
    return this.#holder
  }
  /** Whether there is a token that may start and stop things. */
  get writes() {
    return !!this.#token && this.#holder?.role !== 'viewer'
  }
  /** Whether the token is that of an admin. */
  get governs() {
    return !!this.#token && this.#holder?.role === 'admin'
  }
  /** A log-in failed: says why where a person logs in. */
  refuse(problem: Problem | undefined) {
    this.refusal = problem
    this.asksForToken = true
  }
  /** Keeps a token that the service knows, in this tab or in this browser; an empty string forgets it everywhere. */
  keep(token: string, holder?: Holder, everywhere = false) {
    this.#token = token
    this.#holder = holder
    for (const place of places()) {
      place.removeItem(TOKEN)
      place.removeItem(HOLDER)
    }
    if (!token) return
    const place = everywhere ? localStorage : sessionStorage
    place.setItem(TOKEN, token)
    place.setItem(HOLDER, JSON.stringify(holder ?? null))
  }
  get theme() {
    return this.#theme
  }
  set theme(value: Theme) {
    this.#theme = value
    localStorage.setItem(THEME, value)
    document.documentElement.dataset.theme = value
  }
}

export const settings = new Settings()
