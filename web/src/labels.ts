/** Names, tags and archives in lists. */
import type { Job, JobKind, Label } from './api/types'
import type { Column } from './csv'
import { duration, NONE, num } from './format'
import { english, type Say, type Text } from './language.svelte'
import { powderName } from './names.svelte'
import { route } from './route.svelte'

export type Labelled = { label?: Label | null }

/** Keys of the address for them. */
export const LABEL_KEYS = ['tag', 'archived'] as const

/** Which things the address asks for, as part of a list's query. */
export function wantedLabels(): { tag?: string; archived?: 'include' | 'only' } {
  const archived = route.get('archived')
  return { tag: route.get('tag') || undefined, archived: archived === 'include' || archived === 'only' ? archived : undefined }
}

/** Its name, or else this. */
export const nameOr = (it: Labelled, otherwise: string) => it.label?.name || otherwise

export const tagsOf = (it: Labelled) => it.label?.tags.join(', ') ?? ''

/** A column of tags, if any row has one. */
export const tagColumn = <T extends Labelled>(rows: T[] | undefined): Column<T>[] =>
  rows?.some(tagsOf) ? [{ key: 'tags', label: 'Tags', text: (it) => tagsOf(it) || NONE, sort: tagsOf, left: true }] : []

/** What a job is about: powders by name, policy, angle; in English unless told otherwise. */
export function subjectOf(job: Job, t: Say = english): string {
  const { powders, policy, repose_deg } = job.subject
  const names = powders.map(powderName).join(', ')
  const angle = powders.length === 0 && repose_deg != null ? `${num(repose_deg)}°` : ''
  const of = names || angle
  return policy && of ? t('{policy} on {powder}', { policy, powder: of }) : policy || of
}

/** Kinds of jobs, by the names of their pages. */
export const KIND_NAMES: Record<JobKind, Text> = { calibration: 'Calibration', training: 'Training', evaluation: 'Evaluation', investigation: 'Investigation', repose: 'Angle by camera', film: 'Film' }

/** `next in the queue`, `2nd in the queue`; in English unless told otherwise. */
export const placeText = (place: number, t: Say = english) =>
  t('{place, selectordinal, =1 {next in the queue} one {{place}st in the queue} two {{place}nd in the queue} few {{place}rd in the queue} other {{place}th in the queue}}', { place })

/** Time left of a job that runs, as it was told when it was read; it may be over before the job is. */
export function leftText(job: Job, read: number, now: number, t: Say = english): string {
  if (job.left_s == null) return t('time left not known yet')
  const left = job.left_s - (now - read) / 1000
  return left < 1 ? t('longer than expected') : t('about {time} left', { time: duration(left) })
}

/** How many wait, and how long they take together, as far as earlier ones tell. */
export function queueText(jobs: Job[], t: Say = english): string {
  const waiting = jobs.filter((job) => job.place)
  const known = waiting.flatMap((job) => job.expected_s ?? [])
  const n = waiting.length
  if (n === 0) return ''
  if (known.length === 0) return t('{n, plural, one {{n} waits} other {{n} wait}}; how long they take is not known: none like them has ended here.', { n })
  const time = duration(known.reduce((sum, s) => sum + s, 0))
  if (known.length < n) return t('{n, plural, one {{n} waits} other {{n} wait}}, about {time} for {known} of them; none like the others has ended here.', { n, time, known: known.length })
  return t('{n, plural, one {{n} waits} other {{n} wait}}, about {time} in all.', { n, time })
}
