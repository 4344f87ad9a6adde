/** The parts of a report as the page arranges them: what a reader needs first is open, the rest are details. */

export interface Part {
  /** Its place in the address. */
  id: string
  title: string
  html: string
  /** Whether the page shows it in full. */
  first: boolean
  /** Whether its details are open from the beginning. */
  open: boolean
}

const CAUSE = 'How well each cause explains the data'
/** After the result: cause, gain, what to do next. */
const FIRST = [CAUSE, 'Before and after', 'The next experiment']
/** What stands for the cause where no angles were judged. */
const INSTEAD = ['Spoonfuls', 'Balance readings']

/** Words of the glossary for the headings of a report. */
export const WORDS: Record<string, string> = {
  Result: 'verdict',
  [CAUSE]: 'evidence',
  'Before and after': 'gain',
  'The next experiment': 'next experiment',
  'Where measured and simulated angles differ': 'residual',
  'Effect on each powder': 'effect',
  'Other measurements': 'angle of repose (AoR)',
  Spoonfuls: 'spoonful',
  'Balance readings': 'balance',
  'What these data cannot show': 'blind spot',
  'Columns that were left out': 'condition',
  'Null check': 'null check',
  Provenance: 'provenance',
}

/** The sections that the service rendered. */
export function partsOf(html: string): Part[] {
  const sections = [...new DOMParser().parseFromString(html, 'text/html').querySelectorAll('section')]
  const titles = sections.map((section) => section.querySelector('h2')?.textContent ?? '')
  const angles = titles.includes(CAUSE)
  const parts = sections.map((section, k) => {
    const title = titles[k] || 'Result'
    section.querySelector('h2')?.remove()
    return { id: title.toLowerCase().replaceAll(/[^a-z0-9]+/g, '-'), title, html: section.innerHTML, first: k === 0 || FIRST.includes(title), open: !angles && INSTEAD.includes(title) }
  })
  const place = ({ title }: Part) => FIRST.indexOf(title)
  return [...parts.filter((part) => part.first).sort((a, b) => place(a) - place(b)), ...parts.filter((part) => !part.first)]
}
