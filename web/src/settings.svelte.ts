/** What belongs to this reader: the token (this tab only) and the theme (this browser). */

const TOKEN = 'flip-token'
const THEME = 'flip-theme'

export type Theme = 'system' | 'light' | 'dark'

class Settings {
  #token = $state(sessionStorage.getItem(TOKEN) ?? '')
  #theme = $state<Theme>((localStorage.getItem(THEME) as Theme | null) ?? 'system')
  /** True while the token dialog is open. */
  asksForToken = $state(false)

  constructor() {
    document.documentElement.dataset.theme = this.#theme
  }

  /** The API token, or an empty string: then the page only reads. */
  get token() {
    return this.#token
  }
  set token(value: string) {
    this.#token = value
    if (value) sessionStorage.setItem(TOKEN, value)
    else sessionStorage.removeItem(TOKEN)
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
