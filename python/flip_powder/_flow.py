"""What the clients do, without doing it: generators that ask for requests, pauses and event streams.

The same flow drives the blocking and the asynchronous client, so both retry, wait and refuse alike.
"""

from __future__ import annotations

import json
import random
import time
import uuid
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

from . import _mass
from ._problems import (
    BenchHeldError,
    JobFailedError,
    StillRunningError,
    UnavailableError,
    UncertainError,
    UnreachableError,
    problem,
)
from ._records import ENDED_JOB, ENDED_WEIGHING, Bench, Event, Job, Weighing

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Request:
    """A request to send; the flow is resumed with the answer, or with :class:`UnreachableError` thrown in."""

    method: str
    path: str
    params: Mapping[str, Any] | None = None
    body: bytes | None = None
    headers: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer to a request."""

    status: int
    headers: Mapping[str, str]
    body: bytes

    def json(self) -> Any:
        """The body as JSON; its text if it is none."""
        try:
            return json.loads(self.body)
        except ValueError:
            return self.body.decode(errors="replace")


@dataclass(frozen=True, slots=True)
class Pause:
    """Wait this long, s."""

    seconds: float


@dataclass(frozen=True, slots=True)
class Follow:
    """Read a stream of server-sent events until it ends, breaks off, or `seconds` have passed; the flow is resumed
    with how it ended (:class:`Followed`). `see` is called with every event."""

    path: str
    after_seq: int
    seconds: float
    see: Callable[[Event], None]


@dataclass(frozen=True, slots=True)
class Followed:
    """How a stream ended: by itself, or not; `status` is None if it broke off, and `seen` says whether it spoke."""

    ended: bool
    status: int | None
    seen: bool


Step = Request | Pause | Follow
Flow = Generator[Step, Any, T]

#: Statuses worth another try; on all of them the service has done nothing or says the same again.
RETRIED = frozenset({408, 425, 429, 500, 502, 503, 504})
#: Longest pause between two tries, s.
PAUSE_MAX_S = 5.0
#: How often a wait looks at the bench, s: what is held there moves nothing, so the stream stays silent.
LOOK_S = 10.0
#: Longest wait for what a stream still has of something that has ended, s.
REST_S = 10.0


@dataclass(frozen=True, slots=True)
class Retries:
    """How often to try again what may be tried again."""

    #: Tries after the first.
    count: int = 6
    #: First pause, s; each further one is twice as long, up to 5 s, less a random part of up to a half.
    pause_s: float = 0.2

    def pause(self, tried: int, answer: Answer | None) -> float:
        """Pause after `tried` tries, s."""
        asked = answer.headers.get("retry-after") if answer else None
        if asked and asked.isdigit():
            return min(float(asked), 60.0)
        return float(min(self.pause_s * 2**tried, PAUSE_MAX_S) * random.uniform(0.5, 1.0))


def send(request: Request, retries: Retries) -> Flow[Answer]:
    """Sends a request that may be repeated: one that reads, or one with an idempotency key.

    Raises:
        ProblemError: the service refused it.
        UnreachableError: it never answered.
    """
    sent = False
    for tried in range(retries.count + 1):
        last = tried == retries.count
        try:
            answer: Answer = yield request
            sent = True
        except UnreachableError as error:
            error.sent = sent = sent or error.sent
            if last:
                raise
            yield Pause(retries.pause(tried, None))
            continue
        if answer.status not in RETRIED or last:
            return checked(answer)
        yield Pause(retries.pause(tried, answer))
    raise AssertionError("the last try returns or raises")


def once(request: Request) -> Flow[Answer]:
    """Sends a request that must not be repeated unasked."""
    answer: Answer = yield request
    return checked(answer)


def checked(answer: Answer) -> Answer:
    """The answer, unless it is a refusal."""
    if answer.status >= 400:
        raise problem(answer.status, answer.json())
    return answer


def get(path: str, retries: Retries, params: Mapping[str, Any] | None = None) -> Flow[Any]:
    """JSON from a path."""
    answer = yield from send(Request("GET", path, params=_params(params)), retries)
    return answer.json()


def post(path: str, body: object, retries: Retries, key: str | None = None) -> Flow[Any]:
    """Posts JSON, again and again if it has a key, else once."""
    headers = {"content-type": "application/json"} | ({"idempotency-key": key} if key else {})
    # The same bytes at every try: another body under the same key is refused.
    request = Request("POST", path, body=json.dumps(body).encode(), headers=headers)
    answer = yield from (send(request, retries) if key else once(request))
    return answer.json()


def _params(params: Mapping[str, Any] | None) -> dict[str, str] | None:
    """Query parameters without those that are None."""
    if params is None:
        return None
    of = {True: "true", False: "false"}
    return {name: of[it] if isinstance(it, bool) else str(it) for name, it in params.items() if it is not None}


def order(
    powder: str,
    target: str,
    tolerance: _mass.Tolerance,
    asked: Mapping[str, Any],
    more: Mapping[str, Any],
) -> dict[str, Any]:
    """The body of a request to weigh; without what is None, so that older services understand it."""
    body: dict[str, Any] = {
        "powder": powder,
        "target": _mass.target(target),
        "tolerance": _mass.tolerance(tolerance),
    }
    asked = {name: it for name, it in asked.items() if it is not None}
    return body | ({"asked": asked} if asked else {}) | {name: it for name, it in more.items() if it is not None}


def start(body: Mapping[str, Any], key: str | None, retries: Retries) -> Flow[Weighing]:
    """Asks for a dose, once or again with the same key; the dose is poured at most once."""
    key = key or str(uuid.uuid4())
    try:
        answer = yield from post("/v1/weighings", body, retries, key)
    except (UnreachableError, UnavailableError) as error:
        if isinstance(error, UnreachableError) and not error.sent:
            raise
        raise UncertainError(key, error) from error
    return Weighing.of(answer)


def weighing(id: str, retries: Retries) -> Flow[Weighing]:
    """A weighing with its ticks."""
    return Weighing.of_detail((yield from get(f"/v1/weighings/{id}", retries)))


def wait_for_weighing(
    it: Weighing, timeout_s: float | None, see: Callable[[Event], None] | None, retries: Retries
) -> Flow[Weighing]:
    """Waits until a weighing has ended."""
    ends = Ends(ENDED_WEIGHING, see)
    began = time.monotonic()
    path = f"/v1/weighings/{it.id}/events"
    while True:
        yield from follow(path, ends, _left(began, timeout_s))
        it = yield from weighing(it.id, retries)
        if it.ended:
            yield from rest(path, ends)
            return it
        if timeout_s is not None and time.monotonic() - began >= timeout_s:
            raise StillRunningError(it, timeout_s)
        if it.state in ("planned", "awaiting_vial"):
            bench = Bench.of((yield from get("/v1/bench", retries)))
            if bench.blocked:
                raise BenchHeldError(it, bench.blocked)


def wait_for_job(id: str, timeout_s: float | None, see: Callable[[Event], None] | None, retries: Retries) -> Flow[Job]:
    """Waits until a job has succeeded."""
    ends = Ends(ENDED_JOB, see)
    began = time.monotonic()
    path = f"/v1/jobs/{id}/events"
    while True:
        yield from follow(path, ends, _left(began, timeout_s))
        job = Job.of((yield from get(f"/v1/jobs/{id}", retries)))
        if job.ended:
            yield from rest(path, ends)
        if job.state == "succeeded":
            return job
        if job.ended:
            raise JobFailedError(job)
        if timeout_s is not None and time.monotonic() - began >= timeout_s:
            raise StillRunningError(job, timeout_s)


def _left(began: float, timeout_s: float | None) -> float:
    """Time to follow a stream before looking elsewhere, s."""
    return LOOK_S if timeout_s is None else min(LOOK_S, max(timeout_s - (time.monotonic() - began), 0.0))


class Ends:
    """What a wait has seen of a stream, and whether it can be had at all."""

    def __init__(self, final: frozenset[str], see: Callable[[Event], None] | None) -> None:
        self.final, self.see = final, see
        self.seq = 0
        self.pause_s = 0.2
        self.refused = False
        self.over = False

    def look(self, event: Event) -> None:
        """Takes note of an event and passes it on."""
        self.seq = max(self.seq, event.seq)
        if self.see:
            self.see(event)


def follow(path: str, ends: Ends, seconds: float) -> Flow[None]:
    """Follows a stream for a while; where there is none, pauses instead, longer each time."""
    if not ends.refused:
        followed: Followed = yield Follow(path, ends.seq, seconds, ends.look)
        # Too many streams, a proxy that knows none, an older service: read instead.
        ends.refused = followed.status is not None and followed.status >= 400
        ends.over = followed.ended
        if followed.ended or (followed.seen and not ends.refused):
            return
    pause_s = min(ends.pause_s, seconds)
    ends.pause_s = min(ends.pause_s * 1.5, 2.0)
    if pause_s > 0.0:
        yield Pause(pause_s)


def rest(path: str, ends: Ends) -> Flow[None]:
    """Passes on what a stream still has of something that ended while nobody followed it."""
    if ends.see and not ends.over and not ends.refused:
        yield Follow(path, ends.seq, REST_S, ends.look)


def page(path: str, params: Mapping[str, Any], retries: Retries) -> Flow[tuple[list[Mapping[str, Any]], str | None]]:
    """One page of a list, and where the next one begins."""
    answer = yield from get(path, retries, params)
    return answer["items"], answer.get("next")


def any_request(
    method: str, path: str, params: Mapping[str, Any] | None, body: object, key: str | None, retries: Retries
) -> Flow[Answer]:
    """Any request of the REST interface."""
    headers = {"content-type": "application/json"} if body is not None else {}
    if key is not None:
        headers["idempotency-key"] = key
    content = None if body is None else json.dumps(body).encode()
    request = Request(method, path, _params(params), content, headers)
    repeats = method in ("GET", "HEAD", "PUT", "DELETE") or key is not None
    return (yield from (send(request, retries) if repeats else once(request)))
