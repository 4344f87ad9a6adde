/** A refusal of the service (RFC 9457), or of the network on the way to it. */
export interface FieldProblem {
  field: string
  message: string
}

/** What every kind of problem of this service begins with. */
const OURS = 'urn:flip:problem:'
/** Statuses of the service's refusals before anything was done. */
const REFUSED = [400, 401, 403, 404, 405, 409, 413, 415, 422]

/** What it means that no answer came. */
export const LOST = {
  /** To a view, which asks anew when the service is back. */
  read: 'Is flip serve running? What is shown is from before; the page asks again by itself.',
  /** To what a person wanted to see once. */
  once: 'Is flip serve running? Ask again when it answers.',
  /** To what changes something. */
  write: 'It is not known whether this was taken on: look before you ask again. Nothing is sent again by itself.',
}

export class Problem extends Error {
  constructor(
    readonly title: string,
    readonly detail: string,
    readonly status: number,
    readonly fields: FieldProblem[] = [],
    /** The service itself refused it, and did nothing: not one of the machines between, and not in the middle of doing it. */
    readonly refused = false,
  ) {
    super(detail || title)
  }

  /** From an answer that is not 2xx; tolerates bodies that are no problem document. */
  static from(body: unknown, { status, headers }: Response): Problem {
    const it = (typeof body === 'object' && body !== null ? body : {}) as Record<string, unknown>
    const text = (value: unknown, otherwise: string) => (typeof value === 'string' ? value : otherwise)
    const fields = Array.isArray(it.errors) ? (it.errors as FieldProblem[]) : []
    const ours = headers.get('content-type')?.startsWith('application/problem+json') && text(it.type, '').startsWith(OURS) && it.status === status
    return new Problem(text(it.title, `The service answered ${status}`), text(it.detail, ''), status, fields, !!ours && REFUSED.includes(status))
  }

  /** From anything thrown; `lost` says what it means that no answer came. */
  static of(error: unknown, lost: string = LOST.read): Problem {
    return error instanceof Problem ? error : new Problem('The service does not answer', lost, 0)
  }

  /** What is wrong with one field of a form. */
  field(name: string): string | undefined {
    return this.fields.find((f) => f.field === name)?.message
  }
}
