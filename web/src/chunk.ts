/** Files of the page that are fetched after the first view. */
import { gated } from './api/gate'
import { Problem } from './api/problem'

/**
 * Fetches the files of this name, before they are imported.
 *
 * An import holds its connection until it is answered, and a stop would wait for it. A read gives way to a stop; after
 * it the import finds the file in the browser's cache.
 */
export async function fetchAhead(name: string): Promise<void> {
  for (const file of files(name)) {
    const response = await gated(new Request(file))
    if (response.status === 404) throw new Problem('FLIP has been updated', 'This tab shows the page of an earlier version. Reload it.', 404)
    if (!response.ok) throw Problem.from(undefined, response)
  }
}

/** The build names the files in index.html; in development there are none. */
function files(name: string): string[] {
  const named = document.querySelector<HTMLMetaElement>(`meta[name=flip-${name}]`)?.content
  return named ? named.split(' ') : []
}
