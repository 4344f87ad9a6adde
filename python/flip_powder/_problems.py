"""What can go wrong, as exceptions that say which field and what to do."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ._records import Job, Weighing


class FlipError(Exception):
    """Any error of this package."""


@dataclass(frozen=True, slots=True)
class FieldProblem:
    """A field that the service refused."""

    #: Its path as the request had it, for example `target.value`.
    field: str
    #: The bound, and what to do.
    message: str


class ProblemError(FlipError):
    """The service refused a request (RFC 9457).

    Attributes:
        status: HTTP status.
        type: stable name of the kind of problem, `urn:flip:problem:…`.
        title: the kind in words.
        detail: what went wrong this time, and what to do.
        errors: the refused fields; empty if no single one is at fault.
        instance: the request, as in the service's log.
    """

    def __init__(self, status: int, problem: Mapping[str, Any]) -> None:
        self.status = status
        self.type = str(problem.get("type", "about:blank"))
        self.title = str(problem.get("title", f"HTTP {status}"))
        self.detail = str(problem.get("detail", ""))
        self.instance = problem.get("instance")
        self.errors = tuple(
            FieldProblem(str(it.get("field", "")), str(it.get("message", ""))) for it in problem.get("errors") or ()
        )
        fields = "; ".join(f"{it.field}: {it.message}" for it in self.errors)
        super().__init__(f"{status} {self.title}: {fields or self.detail or 'no detail'}")

    @property
    def fields(self) -> tuple[str, ...]:
        """Paths of the refused fields."""
        return tuple(it.field for it in self.errors)


class RefusedError(ProblemError):
    """400, 413, 415 or 422: the request itself is wrong; `errors` names the fields."""


class NotAllowedError(ProblemError):
    """401 or 403: no token, or one whose role is not sufficient."""


class NotFoundError(ProblemError):
    """404 or 410: there is no such thing, or no longer."""


class ConflictError(ProblemError):
    """409: not in this state, for example a powder without a calibration."""


class UnavailableError(ProblemError):
    """408, 429 or 5xx, after every retry."""


class UnreachableError(FlipError):
    """The service did not answer, after every retry.

    Attributes:
        sent: whether it may have got the request; not if no connection was ever made.
    """

    def __init__(self, message: str, sent: bool = True) -> None:
        self.sent = sent
        super().__init__(message)


class UncertainError(FlipError):
    """A request to weigh was sent, and no answer says whether it was taken.

    Weigh again with the same arguments and `key=error.key`: the dose is then found, or poured, but never poured
    twice.
    """

    def __init__(self, key: str, cause: Exception) -> None:
        self.key = key
        super().__init__(
            f"{cause}; the dose may have been taken: call weigh again with the same arguments and key={key!r}, "
            "never with a new key"
        )


class StillRunningError(FlipError):
    """The time given to wait has passed. What was waited for goes on; read it or stop it, do not replace it."""

    def __init__(self, what: Weighing | Job, timeout_s: float) -> None:
        self.what = what
        super().__init__(f"{what.id} is still {what.state} after {timeout_s:g} s; it goes on")


class BenchHeldError(FlipError):
    """The bench is held or latched, so nothing starts until a person has looked; `weighing` still waits in its
    queue."""

    def __init__(self, weighing: Weighing, reason: str) -> None:
        self.weighing = weighing
        self.reason = reason
        super().__init__(f"weighing {weighing.id} waits, because the bench does not start: {reason}")


class OutcomeError(FlipError):
    """A weighing that did not end within its tolerance, from :meth:`Weighing.raise_for_outcome`."""

    def __init__(self, weighing: Weighing) -> None:
        self.weighing = weighing
        reading = "no reading" if weighing.reading_mg is None else f"{weighing.reading_mg:g} mg"
        why = f": {weighing.error}" if weighing.error else ""
        super().__init__(
            f"weighing {weighing.id} of {weighing.target_mg:g} mg of {weighing.powder} ended {weighing.outcome}, "
            f"{reading}{why}"
        )


class JobFailedError(FlipError):
    """A job that failed or was cancelled."""

    def __init__(self, job: Job) -> None:
        self.job = job
        super().__init__(f"{job.kind} {job.id} {job.state}: {job.error or 'no reason given'}")


def problem(status: int, body: object) -> ProblemError:
    """The exception for an answer of this status."""
    kind: type[ProblemError]
    if status in (401, 403):
        kind = NotAllowedError
    elif status in (404, 410):
        kind = NotFoundError
    elif status == 409:
        kind = ConflictError
    elif status in (408, 429) or status >= 500:
        kind = UnavailableError
    else:
        kind = RefusedError
    return kind(status, body if isinstance(body, Mapping) else {"detail": str(body)[:500]})
