/** This user's settings: the token (this tab only) and the theme (this browser). */

const TOKEN = 'flip-token'
const HOLDER = 'flip-holder'
const THEME = 'flip-theme'

export type Theme = 'system' | 'light' | 'dark'

/** What the service reported about the token. */
export interface Holder {
  role: string
}

function kept(): Holder | undefined {
  try {
    return (JSON.parse(sessionStorage.getItem(HOLDER) ?? 'null') as Holder | null) ?? undefined
  } catch {
    return undefined
  }
}

class Settings {
  #token = $state(sessionStorage.getItem(TOKEN) ?? '')
  #holder = $state.raw(kept())
  #theme = $state<Theme>((localStorage.getItem(THEME) as Theme | null) ?? 'system')
  /** True while the token dialog is open. */
  asksForToken = $state(false)

  constructor() {
    document.documentElement.dataset.theme = this.#theme
  }

  /** The API token, or an empty string: then the page is read-only. */
  get token() {
    return this.#token
  }
  /** The role of the token. */
  get holder() {
    return this.#holder
  }
  /** Keeps a token that the service knows; an empty string forgets it. */
  keep(token: string, holder?: Holder) {
    this.#token = token
    this.#holder = holder
    if (token) sessionStorage.setItem(TOKEN, token)
    else sessionStorage.removeItem(TOKEN)
    sessionStorage.setItem(HOLDER, JSON.stringify(holder ?? null))
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
