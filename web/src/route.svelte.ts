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
    history.replaceState(null, '', link(this.#now.parts, query))
    this.#now = parse()
  }
  /** Goes to another view. */
  go(...parts: string[]) {
    location.hash = link(parts)
  }
}

/** The address of a view, for `href`. */
export function link(parts: string[], query?: URLSearchParams): string {
  const text = query?.toString()
  return `#/${parts.map(encodeURIComponent).join('/')}${text ? `?${text}` : ''}`
}

export const route = new Route()
