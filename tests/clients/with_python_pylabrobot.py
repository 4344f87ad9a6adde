"""Weighs through PyLabRobot's PowderDispenser: `with_python_pylabrobot.py URL TOKEN POWDER`. Prints one JSON document."""

import asyncio
import json
import sys
from importlib.metadata import version

from pylabrobot.powder_dispensing import PowderDispenser
from pylabrobot.resources import Powder, cor_96_wellplate_360uL_Fb

from flip_powder import RefusedError
from flip_powder.pylabrobot import FlipPowderDispenserBackend

url, token, powder = sys.argv[1:]
found: dict[str, object] = {"pylabrobot": version("pylabrobot")}


async def main() -> None:
    dispenser = PowderDispenser(FlipPowderDispenserBackend(url, token, tolerance="3 mg", powders={"NaCl": powder}))
    async with dispenser:
        plate = cor_96_wellplate_360uL_Fb(name="plate")
        wells = plate["A1"] + plate["A2"]
        results = await dispenser.dispense(wells, [Powder("NaCl"), Powder(powder.title())], [12.0, 8.0], lot="L1")
        found["states"] = [abs(it["actual_amount"] - mg) < 4.0 for it, mg in zip(results, (12.0, 8.0), strict=True)]
        client = dispenser.backend.client
        found["vials"] = [(await client.weighing(it["weighing"])).asked.vial for it in results]
        try:
            await dispenser.dispense(plate["A3"], Powder("unobtainium"), 5.0)
        except RefusedError as error:
            found["unknown"] = list(error.fields)
    said = json.dumps(dispenser.serialize())
    found["serialized"] = [token not in said, PowderDispenser.deserialize(json.loads(said)).backend.url == url]


asyncio.run(main())
print(json.dumps(found))
