"""Reads, tares and zeroes the balance through PyLabRobot's Scale. Prints one JSON document.

    with_python_scale.py weigh URL TOKEN POWDER RESERVATION    a bench with a balance; ends when a dose moves
    with_python_scale.py refused URL TOKEN                     a bench that is latched, or has no balance
"""

import asyncio
import datetime
import json
import sys
import time
import warnings

from pylabrobot.scales import Scale
from pylabrobot.scales.scale_backend import ScaleBackend

from flip_powder import AsyncClient, Client, ConflictError, FlipError
from flip_powder.pylabrobot import FlipScaleBackend

what, url, token, *more = sys.argv[1:]
found: dict[str, object] = {}


def scale(**options) -> Scale:
    return Scale("balance", 200, 300, 300, FlipScaleBackend(url, token, **options))


def kind(error: ConflictError) -> str:
    return f"{error.status} {error.type.rpartition(':')[2]}"


async def refused(call) -> str:
    """The kind of problem with which the service refuses."""
    try:
        await call
    except ConflictError as error:
        return kind(error)
    return "not refused"


async def weigh(powder: str, reservation: str) -> None:
    unready = scale()
    try:
        await unready.read_weight()
    except RuntimeError as error:
        found["before_setup"] = str(error)
    async with scale(reservation=reservation) as balance:
        found["vial_g"] = await balance.read_weight()
        await balance.tare()
        found["tared_g"] = [await balance.read_weight(), await balance.read_weight(timeout=0), await balance.read_weight(timeout=2.0)]
        found["zero_with_a_load"] = await refused(balance.zero())
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)
            found["old_name_g"] = [await balance.get_weight(), await balance.backend.get_weight()]
        said = json.dumps(balance.backend.serialize())
        again = ScaleBackend.deserialize(json.loads(said))
        found["serialized"] = [token not in said, again.url == url, again.reservation == reservation]
        async with scale() as other:
            found["reserved"] = [await refused(other.tare()), await refused(other.zero())]
        async with AsyncClient(url, token) as flip:
            tared = await flip.tare_balance(reservation=reservation)
            shown = await flip.balance()
            found["record"] = [type(shown.stable).__name__, shown.readability_mg, shown.balance]
            found["age_s"] = abs((datetime.datetime.now(datetime.timezone.utc) - shown.at).total_seconds())
            found["later"] = tared.at <= shown.at
            asked = {"powder": powder, "target": {"value": 16, "unit": "mg"}, "tolerance": {"lower": 1, "upper": 1, "unit": "mg"}}
            dose = await flip.start_weighing({**asked, "reservation": reservation}, key="scale")
            ends = time.monotonic() + 60
            while (await flip.weighing(dose.id)).state != "dosing" and time.monotonic() < ends:
                await asyncio.sleep(0.02)
        found["busy"] = [await refused(call) for call in (balance.read_weight(), balance.tare(), balance.zero())]


async def not_now() -> None:
    try:
        async with scale() as balance:
            found["read_g"] = await balance.read_weight(timeout=0)
            found["refused"] = [await refused(balance.tare()), await refused(balance.zero())]
    except FlipError as error:
        found["setup"] = str(error)
    with Client(url, token) as flip:
        kinds = []
        for call in (flip.balance, flip.tare_balance, flip.zero_balance):
            try:
                call()
                kinds.append("not refused")
            except ConflictError as error:
                kinds.append(kind(error))
        found["client"] = kinds


asyncio.run(weigh(*more) if what == "weigh" else not_now())
print(json.dumps(found))
