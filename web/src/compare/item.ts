/** One of the things compared: its letter and looks come from its place in the address. */
export interface Item<T = unknown> {
  id: string
  /** Its place, from 0. */
  k: number
  letter: string
  name: string
  read: T
}

/** Heading of its column. */
export const columnOf = (item: Item) => `${item.letter} ${item.name}`
