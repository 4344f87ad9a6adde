/** A film that somebody asks for: found in the list, made by a job if it has to be, then read. */
import { filmGrains, films, startFilm } from '../api/calls'
import { LOST, Problem } from '../api/problem'
import type { FilmOf, FilmRequest } from '../api/types'
import { live } from '../live.svelte'
import { Resource } from '../resource.svelte'
import { settings } from '../settings.svelte'
import { readFilm, UnreadableFilm, type AnyFilm } from './file'

/** To be made while a component is: it listens as long as that lives. */
export class AskedFilm {
  problem = $state.raw<Problem>()
  busy = $state(false)
  #film = $state.raw<AnyFilm>()
  /** The film that was read, by id. */
  #read = $state('')
  /** To be shown as soon as it is made. */
  #wanted = $state(false)
  readonly list: Resource<{ items: FilmOf[] }>
  #ours = $derived.by(() => this.list.value?.items.filter((film) => this.isOurs(film)) ?? [])
  /** The newest of them. */
  known = $derived.by(() => this.#ours.find((film) => film.result) ?? this.#ours[0])
  running = $derived.by(() => this.#ours.find((film) => ['queued', 'running'].includes(film.job.state)))
  /** What was asked for, once it is here. */
  film = $derived.by(() => (this.#film && this.#read === this.known?.job.id ? this.#film : undefined))

  constructor(
    of: { weighing?: string; set?: string; training?: string },
    private readonly isOurs: (film: FilmOf) => boolean,
    private readonly request: () => FilmRequest,
  ) {
    this.list = new Resource(() => films({ ...of, limit: 200 }))
    $effect(() => live.reloads((event) => this.list.value?.items.some((film) => event.topic === `job:${film.job.id}`) ?? false, this.list.reload))
    $effect(() => {
      if (this.#wanted && this.known?.result) void this.#load(this.known.job.id)
    })
  }

  show = async (): Promise<void> => {
    this.problem = undefined
    if (!(await this.#listed())) return
    if (this.known?.result) return this.#load(this.known.job.id)
    if (this.running) return void (this.#wanted = true)
    if (!settings.token) return void (settings.asksForToken = true)
    this.busy = true
    try {
      await startFilm(this.request())
      this.#wanted = true
      await this.list.reload()
    } catch (error) {
      this.problem = Problem.of(error, LOST.write)
    }
    this.busy = false
  }

  /** Whether the films that were made before are known, once they are: until then nobody can say that there is none. */
  async #listed(): Promise<boolean> {
    this.busy = true
    // One that another takes the place of ends without an answer.
    while (!this.list.value) {
      await this.list.reload()
      if (this.list.problem) break
    }
    this.busy = false
    return this.list.value !== undefined
  }

  async #load(id: string) {
    this.#wanted = false
    this.busy = true
    try {
      this.#film = readFilm(await filmGrains(id))
      this.#read = id
    } catch (error) {
      this.problem = error instanceof UnreadableFilm ? new Problem('The film cannot be shown', error.message, 200) : Problem.of(error, LOST.once)
    }
    this.busy = false
  }
}
