"""What the client of `unitelabs-sila` does. Runs where it is installed, and prints one JSON document."""

import asyncio
import json
import sys

from sila.client import Client, ClientConfig
from sila.framework import SiLAError, ValidationError

POWDER = "sand"


def parameters(key, target=15.0, powder=POWDER):
    return {"Powder": powder, "TargetMass": target, "LowerTolerance": 5.0, "UpperTolerance": 5.0, "Vial": "", "Lot": "", "Operator": "", "VialCheck": "Skip",
            "DoseIdentifier": key}


def error(ex):
    said = {"kind": type(ex).__name__, "message": str(ex)}
    if isinstance(ex, ValidationError):
        said["parameter"] = str(ex.parameter)
    return {"error": said}


async def attempt(call):
    try:
        return {"value": await call}
    except SiLAError as ex:
        return error(ex)


async def result(execution):
    try:
        found = await execution.get_responses()
        return {"value": {"Outcome": found.Outcome, "Mass": found.Mass}}
    except SiLAError as ex:
        return error(ex)


async def do_dose(client, key):
    execution = await client.PowderWeighing.DosePowder(**parameters(key))
    masses = [(value.Mass, value.State) async for value in await execution.subscribe_intermediate_responses()]
    return {"uuid": execution.command_execution_uuid, "values": masses, **await result(execution)}


async def do_cancel(client, key, target):
    execution = await client.PowderWeighing.DosePowder(**parameters(key, float(target)))
    async for value in await execution.subscribe_intermediate_responses():
        if value.State == "dosing" and value.Step > 0:
            await client.CancelController.CancelCommand(CommandExecutionUUID=execution.command_execution_uuid)
            break
    async for _ in await execution.subscribe_status():
        pass
    return await result(execution)


async def do_errors(client):
    return {
        "powder": await attempt(client.PowderWeighing.DosePowder(**parameters("u1", powder="no such powder"))),
        "target": await attempt(client.PowderWeighing.DosePowder(**parameters("u2", target=1e6))),
        "state": await client.BenchControl.State.read(),
        "name": await client.SiLAService.ServerName.read() if hasattr(client, "SiLAService") else None,
    }


async def do_who(client):
    return {"uuid": await client.get_server_uuid(), "name": await client.get_server_name(), "state": await client.BenchControl.State.read()}


async def main():
    what, host, port, *more = sys.argv[1:]
    if what == "discover":
        client, what = await Client.discover(uuid=host, timeout=20_000), "who"
    else:
        client = Client(ClientConfig(hostname=host, port=int(port), tls=False))
    async with client:
        print(json.dumps(await globals()[f"do_{what}"](client, *more), default=str), flush=True)


asyncio.run(main())
