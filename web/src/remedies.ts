/** What a person can do about a refusal. */
import type { Problem } from './api/problem'
import type { Say } from './language.svelte'
import { knownPowders } from './names.svelte'
import { link } from './route.svelte'
import { settings } from './settings.svelte'

export interface Remedy {
  /** What is the matter, in the words of the lab. */
  text: string
  /** What the button or link says. */
  label: string
  /** Where it leads; without it, to the token. */
  href?: string
}

/** The powder that a sentence of a refusal is about: the first name in it that is one. */
function powderOf(detail: string) {
  const named = [...detail.matchAll(/`([^`]+)`/g)].map(([, name]) => name)
  return knownPowders().find((powder) => named.includes(powder.id))
}

function ofUncalibrated(detail: string, t: Say): Remedy | undefined {
  const powder = powderOf(detail)
  const [, running] = /calibration `([^`]+)` is under way/.exec(detail) ?? []
  if (powder && running) return { text: t('{powder} has no calibration yet: one is running.', { powder: powder.name }), label: t('Watch it'), href: link(['calibrations', running]) }
  return powder && { text: t('{powder} has no calibration yet: FLIP does not know how it flows.', { powder: powder.name }), label: t('Calibrate {powder}', { powder: powder.name }), href: link(['powders', powder.id], new URLSearchParams({ calibrate: 'yes' })) }
}

/** For the rows of a list: one for each powder that has to be calibrated first. */
export function remediesOfRows({ fields }: Problem, t: Say): Remedy[] {
  const uncalibrated = fields.filter(({ message }) => message.includes('has no parameter set'))
  const remedies = uncalibrated.map(({ message }) => ofUncalibrated(message, t)).filter((it) => it !== undefined)
  return [...new Map(remedies.map((it) => [it.text, it])).values()]
}

export function remedyOf(problem: Problem, t: Say): Remedy | undefined {
  const powder = powderOf(problem.detail)
  switch (problem.code) {
    case 'calibration-missing':
      return ofUncalibrated(problem.detail, t)
    case 'measurement-missing':
      return powder && { text: t('The angle of repose of {powder} has not been measured.', { powder: powder.name }), label: t('Enter a measurement of {powder}', { powder: powder.name }), href: link(['powders', powder.id]) }
    case 'bench-latched':
      return { text: t('The bench is latched: something went wrong, and a person has to look at it.'), label: t('Inspect the bench, then clear it'), href: '#/bench' }
    case 'bench-held':
      return { text: t('The bench is held: someone stopped it.'), label: t('Resume the bench'), href: '#/bench' }
    case 'unauthorized':
    case 'forbidden':
      // In the dialog that asks for a token there is nowhere else to go.
      return settings.asksForToken ? undefined : { text: t(settings.token ? 'Your token does not permit that.' : 'This needs a token.'), label: t(settings.token ? 'Enter another token' : 'Enter a token') }
    default:
      return undefined
  }
}
