/** Where the reader was in each list, for every entry of the browser's history: going back shows the same rows. */
export interface Place {
  /** How many rows had been loaded. */
  count?: number
  /** How far the rows were scrolled, px. */
  top?: number
  /** How far the page was scrolled, px. */
  page?: number
  /** The row that last had the focus. */
  row?: string
}

const KEPT = 'flip-places'
/** Entries of the history that are remembered. */
const ENTRIES_MAX = 50

const places = new Map<string, Record<string, Place>>(kept())
addEventListener('pagehide', () => {
  try {
    sessionStorage.setItem(KEPT, JSON.stringify([...places].slice(-ENTRIES_MAX)))
  } catch {
    // A browser that keeps nothing forgets the place.
  }
})

function kept(): [string, Record<string, Place>][] {
  try {
    return JSON.parse(sessionStorage.getItem(KEPT) ?? '[]') as [string, Record<string, Place>][]
  } catch {
    return []
  }
}

/** The name of the present entry, given to it when it is first asked for. */
function entry(): string {
  const state = (history.state ?? {}) as { entry?: string }
  if (state.entry) return state.entry
  const name = `${performance.timeOrigin + performance.now()}`
  history.replaceState({ ...state, entry: name }, '')
  return name
}

/** The place in this list, to read and to write, for the present entry of the history. */
export function placeIn(list: string): Place {
  const name = entry()
  const here = places.get(name) ?? {}
  places.set(name, here)
  return (here[list] ??= {})
}
