"""Drives FLIP with MADSci's own client of nodes: `python with_madsci_node.py NODE_URL`. Prints one JSON document."""

import json
import sys
import time
from pathlib import Path

import httpx
from madsci.client.node.rest_node_client import RestNodeClient
from madsci.common.types.action_types import ActionRequest
from madsci.common.types.admin_command_types import AdminCommands

client = RestNodeClient(sys.argv[1])
found: dict[str, object] = {}


def dose(**args):
    return ActionRequest(action_name="dose_powder", args={"powder": "sand", "target_mg": 12.0, "tolerance_mg": 3.0, "vial_in_place": True, **args})


info = client.get_info()
found["actions"] = sorted(info.actions)
found["ready"] = client.get_status().ready
found["state"] = sorted(client.get_state())

result = client.send_action(dose(vial="A1"), timeout=120)
found["dose"] = {"status": result.status.value, "powder": result.json_result["powder"], "outcome": result.json_result["outcome"]}
files = result.files.model_dump()
found["files"] = {name: Path(path).read_text()[:40] for name, path in files.items()}
found["history"] = client.get_action_history(result.action_id)[result.action_id][0]["status"]

# A start that got no answer is repeated by the client: the powder must be poured once.
action = client._create_action(dose(vial="A2"))
first = client._start_action("dose_powder", action)
again = client._start_action("dose_powder", action)
found["started_twice"] = [first.json_result["id"] == again.json_result["id"], again.status.value]
client.await_action_result_by_name("dose_powder", action, timeout=120)

# A stop in the middle of a dose.
stopped = client.send_action(dose(vial="A3", target_mg=16.0), await_result=False)
while client.get_state()["bench"]["moving"] is None:
    time.sleep(0.05)
found["busy"] = client.get_status().busy
found["safety_stop"] = client.send_admin_command(AdminCommands.SAFETY_STOP).success
found["stopped"] = client.await_action_result(stopped.action_id, timeout=60).status.value
found["held"] = client.get_status().stopped
found["resume"] = client.send_admin_command(AdminCommands.RESUME).success
found["ready_again"] = client.get_status().ready

# What cannot be done says why.
unknown = client.send_action(dose(powder="unobtainium"))
found["unknown_powder"] = [unknown.status.value, unknown.errors[0].error_type, unknown.errors[0].message]
try:
    client.send_action(ActionRequest(action_name="dose_powder", args={"powder": "sand", "target_gm": 1}))
except httpx.HTTPStatusError as error:
    found["unknown_argument"] = [error.response.status_code, error.response.json()["errors"][0]["field"]]
found["lock"] = client.send_admin_command(AdminCommands.LOCK).success
found["locked"] = client.get_status().locked
found["unlock"] = client.send_admin_command(AdminCommands.UNLOCK).success
found["shutdown"] = client.send_admin_command(AdminCommands.SHUTDOWN).errors[0].message
found["log"] = len(client.get_log()) > 0

print(json.dumps(found))
