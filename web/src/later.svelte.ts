/** What the first view does without: the drawing of plots, and views that are opened less often. One file, fetched ahead while nothing moves. */
import { Problem } from './api/problem'
import { fetchAhead } from './chunk'

/** A quiet page fetches ahead after this time. */
const AHEAD_MS = 4000

class Later {
  /** Undefined until it has arrived. */
  parts = $state.raw<typeof import('./views/later')>()
  problem = $state.raw<Problem>()
  #coming: Promise<void> | undefined

  /** Fetches it now, unless it is here or on its way. */
  load = (): Promise<void> => (this.#coming ??= this.#load().finally(() => (this.#coming = undefined)))

  /** Fetches it when the page has been quiet for a while; the returned function calls that off. For use as an effect's body. */
  ahead(): () => void {
    const idle = globalThis.requestIdleCallback ?? ((act: () => void) => setTimeout(act))
    const timer = setTimeout(() => idle(() => void this.load()), AHEAD_MS)
    return () => clearTimeout(timer)
  }

  async #load() {
    if (this.parts) return
    try {
      await fetchAhead('later')
      this.parts = await import('./views/later')
      this.problem = undefined
    } catch (error) {
      this.problem = Problem.of(error)
    }
  }
}

export const later = new Later()
