/** Saved views of a list: a name for a filter, an order and a choice of columns, kept in this browser. */
import { kept, type Kept } from './kept.svelte'

export interface SavedView {
  name: string
  /** The query of the address, its keys in alphabetical order. */
  query: string
}

/** What the key `hidden` says where every column is shown. */
export const ALL_COLUMNS = '-'
export const NAME_MAX = 60
const VIEWS_MAX = 50

/** A query with these keys only, in an order of its own, so that equal views have equal queries. */
export function queryOf(keys: readonly string[], get: (key: string) => string): string {
  const set = [...keys].sort().map((key) => [key, get(key).trim()] as const)
  return new URLSearchParams(set.filter(([, value]) => value).map(([key, value]) => [key, value])).toString()
}

function isView(value: unknown): value is SavedView {
  const { name, query } = (value ?? {}) as Record<string, unknown>
  return typeof name === 'string' && name !== '' && typeof query === 'string'
}

export class SavedViews {
  #kept: Kept<SavedView[]>

  constructor(list: string) {
    this.#kept = kept(`flip-views-${list}`, (stored) => (Array.isArray(stored) ? stored.filter(isView) : []))
  }

  get all(): SavedView[] {
    return this.#kept.value
  }

  /** What is wrong with a name, if anything; `own` is the view that has it now. */
  wrong(name: string, own?: SavedView): string | undefined {
    const text = name.trim()
    if (!text) return 'Give the view a name.'
    if (text.length > NAME_MAX) return `A name has at most ${NAME_MAX} characters; this one has ${text.length}.`
    const other = this.all.find((view) => view !== own && view.name.toLowerCase() === text.toLowerCase())
    if (other) return `There is a view called “${other.name}”. Choose another name, or remove that one first.`
    if (!own && this.all.length >= VIEWS_MAX) return `There are ${VIEWS_MAX} views, as many as are kept. Remove one first.`
    return undefined
  }

  /** These keep what `wrong` allows; they return what went wrong. */
  save(name: string, query: string): string | undefined {
    return this.wrong(name) ?? this.#keep([...this.all, { name: name.trim(), query }])
  }
  rename(view: SavedView, name: string): string | undefined {
    return this.wrong(name, view) ?? this.#keep(this.all.map((other) => (other === view ? { ...view, name: name.trim() } : other)))
  }
  remove(view: SavedView): string | undefined {
    return this.#keep(this.all.filter((other) => other !== view))
  }

  #keep(views: SavedView[]): string | undefined {
    return this.#kept.set(views) ? undefined : 'This browser keeps nothing: the views last until this tab is closed.'
  }
}
