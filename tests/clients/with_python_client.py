"""Drives FLIP with flip_powder's clients: `with_python_client.py URL TOKEN POWDER`. Prints one JSON document."""

import asyncio
import inspect
import json
import sys
import typing
from unittest import mock

import httpx

import flip_powder
from flip_powder import AsyncClient, Client, ConflictError, NotAllowedError, RefusedError, StillRunningError

url, token, powder = sys.argv[1:]
found: dict[str, object] = {"version": flip_powder.__version__}


class Deaf(httpx.BaseTransport):
    """A network that loses the first answers to requests to weigh, and knows no streams."""

    def __init__(self) -> None:
        self.inner, self.lost, self.asked = httpx.HTTPTransport(), 2, 0

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        if request.url.path.endswith("/events"):
            return httpx.Response(502)
        answer = self.inner.handle_request(request)
        if request.method == "POST" and request.url.path.endswith("/weighings"):
            self.asked += 1
            if self.asked <= self.lost:
                answer.read()
                raise httpx.ReadTimeout("the answer was lost", request=request)
        return answer


with Client(url, token) as flip:
    events: list[flip_powder.Event] = []
    dose = flip.weigh(powder, "12 mg", tolerance="3 mg", vial="A1", lot="L7", operator="Ada", on_event=events.append)
    found["dose"] = {"outcome": dose.outcome, "state": dose.state, "vial": dose.asked.vial, "lot": dose.asked.lot}
    found["close"] = dose.reading_mg is not None and abs(dose.reading_mg - 12.0) <= 3.0
    found["ticks"] = [len(dose.ticks) > 2, dose.ticks[-1].reading.mass_mg == dose.reading_mg]
    found["events"] = {kind for kind in ("state", "tick") if any(event.kind == kind for event in events)} == {"state", "tick"}
    found["events_again"] = [event.seq for event in flip.events(dose)] == [event.seq for event in events]
    # One that looks elsewhere between any two events sees the end there, and still misses none.
    with mock.patch.object(flip_powder._flow, "LOOK_S", 0.02):
        hasty: list[flip_powder.Event] = []
        second = flip.weigh(powder, "10 mg", tolerance="3 mg", key="mine", on_event=hasty.append)
    found["hasty_events"] = [event.seq for event in flip.events(second)] == [event.seq for event in hasty]
    found["stop_of_an_ended_one"] = flip.stop(dose).state
    before = len(list(flip.weighings()))
    with Client(url, token, transport=(deaf := Deaf())) as half:
        try:
            half.weigh(powder, "10 mg", tolerance="3 mg", timeout=0.0)
        except StillRunningError as error:
            again = half.wait(error.what)
    found["lost_answers"] = {"asked": deaf.asked, "poured": len(list(flip.weighings())) - before, "state": again.state}
    found["same_key"] = flip.weigh(powder, "10 mg", tolerance="3 mg", key="mine").id == second.id
    try:
        flip.weigh(powder, "9 mg", tolerance="3 mg", key="mine")
    except RefusedError as error:
        found["other_body"] = error.status
    refusals = {}
    for name, arguments in {"powder": ("unobtainium", "5 mg"), "target": (powder, "5"), "target.value": (powder, "5 g")}.items():
        try:
            flip.weigh(*arguments)
        except RefusedError as error:
            refusals[name] = error.fields == (name,) and name in str(error)
        except ValueError as error:
            refusals[name] = str(error).startswith("target:")
    found["refusals"] = refusals
    try:
        flip.weigh("semolina", "5 mg")
    except ConflictError as error:
        found["uncalibrated"] = "calibrate" in error.detail
    try:
        Client(url, "flip_wrong").weigh(powder, "5 mg")
    except NotAllowedError as error:
        found["wrong_token"] = error.status
    table = flip.weighings(powder=powder, sort="oldest").to_pandas()
    found["pandas"] = [len(table) == 3, table["asked.vial"][0], str(table["created_at"].dtype).startswith("datetime64")]
    arrow = flip.weighings().to_arrow()
    found["arrow"] = [arrow.num_rows, str(arrow.schema.field("target_mg").type)]
    found["powder"] = [flip.powder(powder).flowability is not None, len(flip.powder(powder).sets)]
    found["lists"] = [len(list(it)) > 0 for it in (flip.powders(), flip.jobs(), flip.policies(), flip.parameter_sets())]
    found["trace"] = flip.trace_csv(dose).startswith("step,")
    found["token_is_secret"] = token not in repr(flip)
    found["any_request"] = flip.request("GET", "/v1/me").status


async def many() -> None:
    """The asynchronous client, two doses at once."""
    async with AsyncClient(url, token) as flip:
        doses = await asyncio.gather(*(flip.weigh(powder, f"{mg} mg", tolerance="3 mg") for mg in (8, 10)))
        found["async"] = [dose.state for dose in doses]
        found["async_events"] = len([event async for event in flip.events(doses[0])]) > 3
        found["async_list"] = len(await flip.weighings().all()) == (await flip.weighings().to_arrow()).num_rows


asyncio.run(many())

# The generated client has every operation, and the two are one service.
from flip_powder.api import AuthenticatedClient  # noqa: E402
from flip_powder.api.api.weighings import get_weighing  # noqa: E402

generated = get_weighing.sync(dose.id, client=AuthenticatedClient(url, token))
found["generated"] = generated is not None and generated.to_dict()["weighing"]["id"] == dose.id

# Every record's fields exist in the OpenAPI document under the same name, and what a record needs is always answered.
schemas = httpx.get(f"{url}/openapi.json").json()["components"]["schemas"]
wrong = []
for name, record in inspect.getmembers(flip_powder, inspect.isclass):
    schema = {"Hold": "Held", "Bench": "BenchStatus"}.get(name, name)
    if not issubclass(record, flip_powder._records.Record) or schema not in schemas:
        continue
    known = schemas[schema].get("properties", {})
    more = {"Weighing": {"ticks", "labels"}, "Powder": {"measurements", "sets"}}.get(name, set())
    wrong += [f"{name}.{it}" for it in typing.get_type_hints(record) if it not in known and it not in more | {"raw"}]
found["records"] = wrong
print(json.dumps(found))
