/** The one that is looked at among many: pointed at for a moment, or chosen and kept in the address. */
import { route } from '../route.svelte'
import { listOf } from './address'

class Focus {
  /** Id of the one under the pointer. */
  pointed = $state('')

  get chosen() {
    const id = route.get('focus')
    // One that is no longer compared would leave all others faded.
    return listOf(route.get('ids')).includes(id) ? id : ''
  }
  choose(id: string) {
    route.set({ focus: this.chosen === id ? '' : id })
  }
  /** The others step back. */
  faded(id: string): boolean {
    const at = this.pointed || this.chosen
    return at !== '' && at !== id
  }
}

export const focus = new Focus()
