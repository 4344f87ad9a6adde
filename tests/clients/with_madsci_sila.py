"""What MADSci's SilaNodeClient does. Runs where it is installed, and prints one JSON document."""

import json
import sys
import time

from madsci.client.node.sila_node_client import SilaNodeClient
from madsci.common.types.action_types import ActionRequest

POWDER = "sand"


def request(key, target=15.0, powder=POWDER):
    return ActionRequest(action_name="PowderWeighing.DosePowder", args={
        "Powder": powder, "TargetMass": target, "LowerTolerance": 5.0, "UpperTolerance": 5.0, "Vial": "", "Lot": "", "Operator": "", "VialCheck": "Skip",
        "DoseIdentifier": key})


def said(result):
    return {"status": result.status.value, "result": result.json_result, "errors": [{"kind": it.error_type, "message": it.message} for it in result.errors]}


def do_dose(client, key):
    info = client.get_info()
    begun = client.send_action(request(key), await_result=False)
    busy = client.get_status().busy
    while not client.get_action_status(begun.action_id).is_terminal:
        time.sleep(0.1)
    ended = client.get_action_result(begun.action_id)
    return {"node": info.node_name, "actions": sorted(info.actions), "begun": begun.status.value, "busy": busy, **said(ended), "state": client.get_state()}


def do_cancel(client, key, target):
    begun = client.send_action(request(key, float(target)), await_result=False)
    instance = client._running_commands[begun.action_id][0]
    while not instance.progress:
        time.sleep(0.02)
    cancel = ActionRequest(action_name="CancelController.CancelCommand", args={"CommandExecutionUUID": str(instance.execution_uuid)})
    cancelled = client.send_action(cancel)
    return {"cancel": said(cancelled), **said(client.await_action_result(begun.action_id, timeout=240))}


def do_errors(client):
    return {"powder": said(client.send_action(request("m1", powder="no such powder"))), "target": said(client.send_action(request("m2", target=1e6)))}


def main():
    what, host, port, *more = sys.argv[1:]
    client = SilaNodeClient(f"sila://{host}:{port}")
    print("\n" + json.dumps(globals()[f"do_{what}"](client, *more), default=str), flush=True)
    client.close()


main()
