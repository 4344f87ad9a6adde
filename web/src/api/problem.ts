/** A refusal of the service (RFC 9457), or of the network on the way to it. */
export interface FieldProblem {
  field: string
  message: string
}

export class Problem extends Error {
  constructor(
    readonly title: string,
    readonly detail: string,
    readonly status: number,
    readonly fields: FieldProblem[] = [],
  ) {
    super(detail || title)
  }

  /** From the body of an answer that is not 2xx; tolerates bodies that are no problem document. */
  static from(body: unknown, status: number): Problem {
    const it = (typeof body === 'object' && body !== null ? body : {}) as Record<string, unknown>
    const text = (value: unknown, otherwise: string) => (typeof value === 'string' ? value : otherwise)
    const fields = Array.isArray(it.errors) ? (it.errors as FieldProblem[]) : []
    return new Problem(text(it.title, `The service answered ${status}`), text(it.detail, ''), status, fields)
  }

  /** From anything thrown. */
  static of(error: unknown): Problem {
    if (error instanceof Problem) return error
    return new Problem('The service does not answer', 'Is flip serve running? The page tries again by itself.', 0)
  }

  /** What is wrong with one field of a form. */
  field(name: string): string | undefined {
    return this.fields.find((f) => f.field === name)?.message
  }
}
