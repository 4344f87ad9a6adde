"""The blocking client, made from `_async_client.py` by `unasync.py`."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from types import TracebackType
from typing import Any, TypeVar, overload

import httpx

from . import _flow
from ._flow import Answer, Flow, Follow, Followed, Pause, Request, Retries
from ._mass import Tolerance
from ._problems import ConflictError, UnreachableError
from ._records import ENDED_JOB, BalanceReading, Bench, CalibratedSet, Event, Job, Policy, Powder, Record, Weighing
from ._requests import RETRIES, TIMEOUT_S, Settings, asked, part
from ._sse import Lines
from ._tables import Listing

T = TypeVar("T")
R = TypeVar("R", bound=Record)
See = Callable[[Event], None]


class Client:
    """A FLIP service, called and waited for.

    Args:
        url: where it listens; default the environment's `FLIP_URL`, else `http://127.0.0.1:8080`.
        token: a token of the service; default the environment's `FLIP_TOKEN`. Reading needs none on a loopback
            address.
        timeout_s: longest silence of the service within one request, s.
        retries: how often to try again what may be repeated; default six times.
        transport: an httpx transport in place of the network.

    Example:
        >>> with Client(token="flip_…") as flip:
        ...     dose = flip.weigh("salt", "15 mg", tolerance="1 mg", vial="A1")
        ...     print(dose.outcome, dose.reading_mg)
    """

    def __init__(
        self,
        url: str | None = None,
        token: str | None = None,
        *,
        timeout_s: float = TIMEOUT_S,
        retries: Retries | int = RETRIES,
        transport: httpx.BaseTransport | None = None,
    ) -> None:
        self._settings = Settings(url, token, timeout_s, retries)
        self._retries = self._settings.retries
        self._http = httpx.Client(
            base_url=self._settings.url, headers=self._settings.headers(), timeout=timeout_s, transport=transport
        )

    def __repr__(self) -> str:
        return f"Client({self._settings!r})"

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Closes its connections."""
        self._http.close()

    # Weighing

    def weigh(
        self,
        powder: str,
        target: str,
        *,
        tolerance: Tolerance = "1 mg",
        vial: str | None = None,
        lot: str | None = None,
        operator: str | None = None,
        position: str | None = None,
        labels: Mapping[str, str] | None = None,
        policy: str | None = None,
        seed: int | None = None,
        retry_overdose: int | None = None,
        vial_check: str | None = None,
        reservation: str | None = None,
        asked_more: Mapping[str, Any] | None = None,
        key: str | None = None,
        timeout: float | None = None,
        on_event: See | None = None,
    ) -> Weighing:
        """Weighs a dose and waits until it has ended.

        The request carries one idempotency key, and lost answers and restarts are met by the same request with the
        same key: a dose is poured at most once.

        Args:
            powder: id of a powder that has been calibrated.
            target: mass with its unit, as `"15 mg"` or `"0.015 g"`.
            tolerance: accepted error, as `"1 mg"`, `"5 %"`, or `("0.5 mg", "1 mg")` for shortfall and excess.
            vial, lot, operator, position: recorded with the dose. On a bench that cannot exchange vials the dose
                waits until a person confirms that the vial is in.
            labels: a string map attached to the dose (a service of 0.1.0 or older refuses it).
            policy: id of a policy; default the best for the powder.
            seed: seed of a simulated bench.
            retry_overdose: how often to discard an overdose and start again, 1 to 5, where vials can be exchanged.
            vial_check: `"skip"` only if a machine knows that an empty vial is in.
            reservation: id of the bench's reservation.
            asked_more: further fields of `asked`, as in the REST reference.
            key: idempotency key, 1 to 255 visible ASCII characters; default a new one. Save your own, with the
                arguments, to be able to ask again after your program has died.
            timeout: longest wait, s; default none. The dose goes on when it has passed.
            on_event: called with every event of the dose.

        Returns:
            The weighing, whatever its outcome; `.raise_for_outcome()` insists on the tolerance.

        Raises:
            ValueError: a quantity without its unit.
            ProblemError: the service refused the request; it names the field.
            UncertainError: no answer says whether the request was taken; it has the key to ask again with.
            StillRunningError: `timeout` has passed.
            BenchHeldError: the bench does not start until a person has looked.
        """
        more = {
            "labels": dict(labels) if labels is not None else None,
            "policy": policy,
            "seed": seed,
            "vial_check": vial_check,
            "reservation": reservation,
        }
        circumstances = asked(vial, lot, operator, position, retry_overdose, asked_more)
        body = _flow.order(powder, target, tolerance, circumstances, more)
        begun = self._run(_flow.start(body, key, self._retries))
        return self._run(_flow.wait_for_weighing(begun, timeout, on_event, self._retries))

    def start_weighing(self, body: Mapping[str, Any], *, key: str | None = None) -> Weighing:
        """Asks for a dose by the body of the REST interface, without waiting for it.

        Raises:
            ProblemError, UncertainError: as :meth:`weigh`.
        """
        return self._run(_flow.start(body, key, self._retries))

    def weighing(self, id: str) -> Weighing:
        """A weighing with its ticks."""
        return self._run(_flow.weighing(part(id), self._retries))

    def weighings(self, **filters: Any) -> Listing[Weighing]:
        """Weighings, the newest first.

        Args:
            **filters: as the REST interface has them: `powder`, `lot`, `vial`, `operator`, `state`, `outcome`,
                `since`, `until`, `q`, `sort`, …
        """
        return self._list("/v1/weighings", filters, Weighing.of)

    @overload
    def wait(self, it: Weighing, *, timeout: float | None = None, on_event: See | None = None) -> Weighing: ...

    @overload
    def wait(self, it: Job, *, timeout: float | None = None, on_event: See | None = None) -> Job: ...

    def wait(
        self,
        it: Weighing | Job,
        *,
        timeout: float | None = None,
        on_event: See | None = None,
    ) -> Weighing | Job:
        """Waits until a weighing has ended or a job has succeeded, and returns it.

        Raises:
            StillRunningError: `timeout`, s, has passed.
            BenchHeldError: the bench does not start.
            JobFailedError: the job failed or was cancelled.
        """
        if isinstance(it, Weighing):
            return self._run(_flow.wait_for_weighing(it, timeout, on_event, self._retries))
        return self._run(_flow.wait_for_job(it.id, timeout, on_event, self._retries))

    def events(self, it: Weighing | Job, *, after_seq: int = 0) -> Iterator[Event]:
        """The events of a weighing or a job as they happen, until it has ended. Connections that break off are made
        again, and nothing is missed."""
        kind = "weighings" if isinstance(it, Weighing) else "jobs"
        path = f"/v1/{kind}/{part(it.id)}/events"
        tried = 0
        while True:
            try:
                with self._stream(path, after_seq, self._settings.timeout_s) as answer:
                    if answer.status_code == 204:
                        return
                    if answer.status_code >= 400:
                        answer.read()
                        _flow.checked(_answer(answer))
                    lines = Lines()
                    for line in answer.iter_lines():
                        if event := lines.feed(line):
                            after_seq, tried = event.seq, 0
                            yield event
            except httpx.TransportError as error:
                if tried >= self._retries.count:
                    raise UnreachableError(f"{self._settings.url} broke off: {error!r}") from error
                time.sleep(self._retries.pause(tried, None))
                tried += 1

    def stop(self, it: Weighing | str) -> Weighing:
        """Stops a weighing. One that has ended is returned as it is."""
        id = it if isinstance(it, str) else it.id
        try:
            self._run(_flow.send(Request("POST", f"/v1/weighings/{part(id)}/stop"), self._retries))
        except ConflictError:
            ended = self.weighing(id)
            if not ended.ended:
                raise
            return ended
        return self.weighing(id)

    def trace_csv(self, it: Weighing | str) -> str:
        """The course of a weighing as CSV."""
        id = it if isinstance(it, str) else it.id
        return self.request("GET", f"/v1/weighings/{part(id)}/trace.csv").body.decode()

    # The bench

    def bench(self) -> Bench:
        """The bench, and whether it may be used."""
        return Bench.of(self._run(_flow.get("/v1/bench", self._retries)))

    def stop_bench(self) -> None:
        """Stops everything that moves. Nothing starts until a person resumes."""
        self._run(_flow.send(Request("POST", "/v1/bench/stop"), self._retries))

    def balance(self) -> BalanceReading:
        """What the balance shows now, outside of a dose; it may not be stable yet.

        Raises:
            ConflictError: a dose or a pile is being made (`type` ends in `bench-busy`), the bench is simulated and has
                no balance (`no-balance`), or the balance failed (`balance-failed`).
        """
        return BalanceReading.of(self._run(_flow.get("/v1/bench/balance", self._retries)))

    def tare_balance(self, *, reservation: str | None = None) -> BalanceReading:
        """Tares the balance with what is on it, once the reading is stable. Each dose tares again by itself.

        Args:
            reservation: id of the bench's reservation.

        Returns:
            What the balance shows afterwards.

        Raises:
            ConflictError: as :meth:`balance`; or the bench is latched (`bench-latched`) or reserved
                (`bench-reserved`).
            UnreachableError: no answer; it may have been tared if `error.sent`.
        """
        return self._to_balance("tare", reservation)

    def zero_balance(self, *, reservation: str | None = None) -> BalanceReading:
        """Sets the balance's zero point, with an empty pan: with a load beyond its zero range a balance refuses.

        Args:
            reservation: id of the bench's reservation.

        Returns:
            What the balance shows afterwards.

        Raises:
            ConflictError: as :meth:`tare_balance`.
            UnreachableError: no answer; it may have been zeroed if `error.sent`.
        """
        return self._to_balance("zero", reservation)

    def _to_balance(self, what: str, reservation: str | None) -> BalanceReading:
        body = {} if reservation is None else {"reservation": reservation}
        return BalanceReading.of(self._run(_flow.post(f"/v1/bench/balance/{what}", body, self._retries)))

    # Powders, calibrations, jobs

    def powders(self, **filters: Any) -> Listing[Powder]:
        """Powders."""
        return self._list("/v1/powders", filters, Powder.of)

    def powder(self, id: str) -> Powder:
        """A powder with its measurements and calibrated sets."""
        return Powder.of_detail(self._run(_flow.get(f"/v1/powders/{part(id)}", self._retries)))

    def calibrate(self, powder: str, *, wait: bool = True, timeout: float | None = None, **settings: Any) -> Job:
        """Finds simulated powders that pile like this one.

        Args:
            powder: id of the powder.
            wait: whether to wait until it has succeeded.
            timeout: longest wait, s.
            **settings: as the REST interface has them: `sets`, `method`, `seed`, …

        Raises:
            ProblemError: refused; it names the field.
            JobFailedError: it failed.
            StillRunningError: `timeout` has passed.
        """
        body = {"powder": powder} | settings
        job = Job.of(self._run(_flow.post("/v1/calibrations", body, self._retries)))
        return self._run(_flow.wait_for_job(job.id, timeout, None, self._retries)) if wait else job

    def jobs(self, **filters: Any) -> Listing[Job]:
        """Jobs, the newest first."""
        return self._list("/v1/jobs", filters, Job.of)

    def job(self, id: str) -> Job:
        """A job."""
        return Job.of(self._run(_flow.get(f"/v1/jobs/{part(id)}", self._retries)))

    def cancel(self, job: Job | str) -> Job:
        """Cancels a job. One that has ended is returned as it is."""
        id = job if isinstance(job, str) else job.id
        try:
            return Job.of(self._run(_flow.post(f"/v1/jobs/{part(id)}/cancel", {}, self._retries)))
        except ConflictError:
            ended = self.job(id)
            if ended.state not in ENDED_JOB:
                raise
            return ended

    def policies(self, **filters: Any) -> Listing[Policy]:
        """Policies."""
        return self._list("/v1/policies", filters, Policy.of)

    def import_policy(self, file: bytes) -> Policy:
        """Stores a policy that was trained elsewhere, to evaluate it and to weigh with it.

        Args:
            file: safetensors with a manifest, as :func:`flip_powder.env.policy_file` makes them.
        """
        headers = {"content-type": "application/octet-stream"}
        request = Request("POST", "/v1/policies", body=file, headers=headers)
        # The id is the file's content: sending it again stores nothing twice.
        return Policy.of(self._run(_flow.send(request, self._retries)).json())

    def parameter_sets(self, **filters: Any) -> Listing[CalibratedSet]:
        """Calibrated parameter sets."""
        return self._list("/v1/parameter-sets", filters, CalibratedSet.of)

    # Everything else

    def request(
        self,
        method: str,
        path: str,
        *,
        params: Mapping[str, Any] | None = None,
        json: object = None,
        key: str | None = None,
    ) -> Answer:
        """Sends any request of the REST interface, for example `client.request("GET", "/v1/labels").json()`.

        Reading, and writing with an idempotency key, is tried again; other writing is not.

        Raises:
            ProblemError: the service refused it.
            UnreachableError: it did not answer.
        """
        return self._run(_flow.any_request(method, path, params, json, key, self._retries))

    # Driving the flows

    def _list(self, path: str, filters: Mapping[str, Any], of: Callable[[Mapping[str, Any]], R]) -> Listing[R]:
        def read(after: str | None) -> tuple[list[Mapping[str, Any]], str | None]:
            return self._run(_flow.page(path, {"limit": 200} | dict(filters) | {"after": after}, self._retries))

        return Listing(read, of)

    def _run(self, flow: Flow[T]) -> T:
        """Drives a flow to its end."""
        step = next(flow)
        while True:
            try:
                match step:
                    case Request():
                        try:
                            answer = self._send(step)
                        except UnreachableError as error:
                            step = flow.throw(error)
                        else:
                            step = flow.send(answer)
                    case Pause():
                        time.sleep(step.seconds)
                        step = flow.send(None)
                    case Follow():
                        step = flow.send(self._follow(step))
            except StopIteration as end:
                returned: T = end.value
                return returned

    def _send(self, request: Request) -> Answer:
        try:
            answer = self._http.request(
                request.method,
                request.path,
                params=request.params,
                content=request.body,
                headers=dict(request.headers),
            )
        except httpx.TransportError as error:
            sent = not isinstance(error, httpx.ConnectError | httpx.ConnectTimeout | httpx.PoolTimeout)
            raise UnreachableError(f"{self._settings.url} did not answer: {error!r}", sent) from error
        return _answer(answer)

    def _stream(self, path: str, after_seq: int, timeout_s: float) -> Any:
        return self._http.stream(
            "GET",
            path,
            headers={"accept": "text/event-stream", "last-event-id": str(after_seq)},
            timeout=httpx.Timeout(self._settings.timeout_s, read=max(timeout_s, 0.01)),
        )

    def _follow(self, follow: Follow) -> Followed:
        seen, ends = False, time.monotonic() + follow.seconds
        try:
            with self._stream(follow.path, follow.after_seq, follow.seconds) as answer:
                if answer.status_code != 200:
                    return Followed(answer.status_code == 204, answer.status_code, False)
                lines = Lines()
                for line in answer.iter_lines():
                    if event := lines.feed(line):
                        seen = True
                        follow.see(event)
                    if time.monotonic() >= ends:
                        return Followed(False, None, seen)
        except httpx.TransportError:
            return Followed(False, None, seen)
        return Followed(True, 200, seen)


def _answer(answer: httpx.Response) -> Answer:
    return Answer(answer.status_code, {name.lower(): it for name, it in answer.headers.items()}, answer.content)
