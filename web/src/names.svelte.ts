/** Names of powders by ID, read once and again after a powder is added. */
import { powders } from './api/calls'
import { words } from './format'
import { live } from './live.svelte'
import { all, Resource } from './resource.svelte'

const list = new Resource(() => all((q) => powders({ ...q, archived: 'include' })))
live.on((event) => {
  if (event.topic === 'label') void list.reload()
})

/** All powders but archived ones, oldest first. */
export function knownPowders() {
  return (list.value ?? []).filter((p) => !p.label?.archived_at)
}

export function powderName(id: string | null | undefined): string {
  if (!id) return 'Bare angle'
  return list.value?.find((p) => p.id === id)?.name ?? words(id)
}

/** After a powder was added. */
export const reloadNames = list.reload
