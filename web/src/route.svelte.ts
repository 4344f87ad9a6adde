/** The address is the state: `#/weighings/ID?powder=salt`. Reload, bookmark and back show the same page. */

function parse() {
  const [path = '', query = ''] = location.hash.replace(/^#\/?/, '').split('?')
  return { parts: path.split('/').filter(Boolean).map(decodeURIComponent), query: new URLSearchParams(query) }
}

class Route {
  #now = $state.raw(parse())

  constructor() {
    addEventListener('hashchange', () => (this.#now = parse()))
  }

  /** First part of the path: which view; empty for the overview. */
  get view() {
    return this.#now.parts[0] ?? ''
  }
  /** Second part of the path: which powder, policy, job… */
  get id() {
    return this.#now.parts[1] ?? ''
  }
  /** One value from the query. */
  get(key: string): string {
    return this.#now.query.get(key) ?? ''
  }
  /** Changes the query in place, without a new entry in the history. An empty value removes its key. */
  set(changes: Record<string, string>) {
    const query = new URLSearchParams(this.#now.query)
    for (const [key, value] of Object.entries(changes)) {
      if (value) query.set(key, value)
      else query.delete(key)
    }
    history.replaceState(history.state, '', link(this.#now.parts, query))
    this.#now = parse()
  }
  /** Opens something on the same view: a step forward, which the browser's Back takes back. */
  open(changes: Record<string, string>) {
    history.pushState({ opened: true }, '', location.href)
    this.set(changes)
  }
  /** Closes it again: the step is taken back, or the address changed where it was opened by its address. */
  close(key: string) {
    if ((history.state as { opened?: boolean } | null)?.opened) history.back()
    else this.set({ [key]: '' })
  }
  /** Goes to another view. */
  go(...parts: string[]) {
    location.hash = link(parts)
  }
  /** Goes on to what a form made, which takes the form's place in the history: Back leads to where it was opened. */
  made(address: string) {
    location.replace(address)
  }
}

/** The address of a view, for `href`. */
export function link(parts: string[], query?: URLSearchParams): string {
  const text = query?.toString()
  return `#/${parts.map(encodeURIComponent).join('/')}${text ? `?${text}` : ''}`
}

export const route = new Route()
