"""Weighs while the service is killed and started again: `with_python_kill.py URL TOKEN POWDER KEY`. Prints one JSON document."""

import json
import sys

from flip_powder import Client, Event, Retries

url, token, powder, key = sys.argv[1:]


def told(event: Event) -> None:
    """Tells the test that the dose moves: it kills the service then."""
    if event.kind == "tick":
        print("moving", flush=True)


with Client(url, token, retries=Retries(count=20)) as flip:
    dose = flip.weigh(powder, "12 mg", tolerance="3 mg", key=key, on_event=told)
    again = flip.weigh(powder, "12 mg", tolerance="3 mg", key=key)
    same = [it.id for it in flip.weighings()]
print(json.dumps({"state": dose.state, "outcome": dose.outcome, "same": again.id == dose.id, "weighings": len(same)}))
