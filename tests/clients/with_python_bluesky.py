"""Weighs in plans of Bluesky's RunEngine: `with_python_bluesky.py URL TOKEN POWDER`. Prints one JSON document."""

import json
import sys
from importlib.metadata import version

import bluesky.plan_stubs as bps
from bluesky import RunEngine
from bluesky.protocols import Locatable, Movable, Readable, Stoppable
from bluesky.utils import FailedStatus
from ophyd_async.core import init_devices

from flip_powder.bluesky import Doser

url, token, powder = sys.argv[1:]
found: dict[str, object] = {"bluesky": version("bluesky"), "ophyd_async": version("ophyd-async")}
documents: list[tuple[str, dict]] = []
engine = RunEngine()
engine.subscribe(lambda name, document: documents.append((name, document)))
with init_devices():
    doser = Doser(powder, url, token, tolerance="3 mg")
found["protocols"] = [isinstance(doser, it) for it in (Movable, Readable, Stoppable, Locatable)]


def plan():
    yield from bps.open_run()
    for mg in (12.0, 8.0):
        yield from bps.abs_set(doser.vial, f"V{mg:g}", wait=True)
        yield from bps.mv(doser, mg)
        yield from bps.create()
        yield from bps.read(doser)
        yield from bps.save()
    yield from bps.close_run()


engine(plan())
events = [document["data"] for name, document in documents if name == "event"]
found["doses"] = [abs(it["doser-reading"] - mg) < 4.0 and it["doser-target"] == mg for it, mg in zip(events, (12.0, 8.0), strict=True)]
descriptor = next(document for name, document in documents if name == "descriptor")
found["units"] = descriptor["data_keys"]["doser-reading"]["units"]
found["vial"] = descriptor["configuration"]["doser"]["data"]["doser-vial"]
found["exit"] = next(document for name, document in documents if name == "stop")["exit_status"]


def moved():
    """Watchers see the balance's readings; a stop in the middle ends the dose."""
    status = yield from bps.abs_set(doser, 16.0)
    shown: list[float] = []
    status.watch(lambda **update: shown.append(update["current"]))
    while not shown:
        yield from bps.sleep(0.05)
    yield from bps.stop(doser)
    try:
        yield from bps.wait_for([lambda: status.task])
    except Exception:
        pass
    found["stopped"] = [len(shown) > 0, "stopped" in str(status.exception())]


try:
    engine(moved())
except FailedStatus as error:
    found["stopped"] = ["FailedStatus", "stopped" in str(error)]
print(json.dumps(found))
