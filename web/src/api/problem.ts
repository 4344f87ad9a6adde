/** A refusal by the service (RFC 9457), or a failure of the network on the way to it. */
export interface FieldProblem {
  field: string
  message: string
}

/** Prefix of every problem type of this service. */
const OURS = 'urn:flip:problem:'
/** Statuses with which the service refuses before it does anything. */
const REFUSED = [400, 401, 403, 404, 405, 409, 413, 415, 422]

/** What a missing response means. */
export const LOST = {
  /** For a view, which reloads when the service is back. */
  read: 'Is flip serve running? The values shown are out of date; the page retries automatically.',
  /** For something a person wanted to see once. */
  once: 'Is flip serve running? Try again when it responds.',
  /** For a request that changes something. */
  write: 'It is not known whether this was accepted: check before you try again. Nothing is resent automatically.',
}

export class Problem extends Error {
  constructor(
    readonly title: string,
    readonly detail: string,
    readonly status: number,
    readonly fields: FieldProblem[] = [],
    /** The service itself refused it and did nothing: it was not refused by a machine in between, nor halfway through. */
    readonly refused = false,
    /** The kind of refusal, as `calibration-missing`; empty for a failure of the network. */
    readonly code = '',
  ) {
    super(detail || title)
  }

  /** From a response that is not 2xx; tolerates bodies that are not a problem document. */
  static from(body: unknown, { status, headers }: Response): Problem {
    const it = (typeof body === 'object' && body !== null ? body : {}) as Record<string, unknown>
    const text = (value: unknown, otherwise: string) => (typeof value === 'string' ? value : otherwise)
    const fields = Array.isArray(it.errors) ? (it.errors as FieldProblem[]) : []
    const ours = headers.get('content-type')?.startsWith('application/problem+json') && text(it.type, '').startsWith(OURS) && it.status === status
    const type = text(it.type, '')
    const code = type.startsWith(OURS) ? type.slice(OURS.length) : ''
    return new Problem(text(it.title, `The service returned ${status}`), text(it.detail, ''), status, fields, !!ours && REFUSED.includes(status), code)
  }

  /** From anything thrown; `lost` says what a missing response means. */
  static of(error: unknown, lost: string = LOST.read): Problem {
    return error instanceof Problem ? error : new Problem('The service is not responding', lost, 0)
  }

  /** What is wrong with one field of a form. */
  field(name: string): string | undefined {
    return this.fields.find((f) => f.field === name)?.message
  }
}
