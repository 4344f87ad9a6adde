"""Runs a workflow of two doses with MADSci's own workcell engine: `python with_madsci_engine.py NODE_URL`.

The engine keeps its state in memory; a server that knows no places stands in for MADSci's location manager. Prints one
JSON document: the workflow's status and the outcome of each step.
"""

import http.server
import json
import sys
import threading
import time

from madsci.client.data_client import DataClient
from madsci.common.context import madsci_context
from madsci.common.db_handlers.cache_handler import InMemoryCacheHandler
from madsci.common.db_handlers.document_storage_handler import InMemoryDocumentStorageHandler
from madsci.common.types.parameter_types import *  # noqa: F403 - resolves the names that the workflow's models defer
from madsci.common.types.step_types import StepDefinition
from madsci.common.types.workcell_types import WorkcellManagerSettings
from madsci.common.types.workflow_types import WorkflowDefinition
from madsci.workcell_manager.state_handler import WorkcellStateHandler
from madsci.workcell_manager.workcell_engine import Engine
from madsci.workcell_manager.workflow_utils import create_workflow


class NoPlaces(http.server.BaseHTTPRequestHandler):
    def do_GET(self):
        self.send_response(200)
        self.send_header("Content-Type", "application/json")
        self.end_headers()
        self.wfile.write(b"[]")

    def log_message(self, *_):
        pass


def main(node: str) -> None:
    places = http.server.ThreadingHTTPServer(("127.0.0.1", 0), NoPlaces)
    threading.Thread(target=places.serve_forever, daemon=True).start()
    with madsci_context(location_server_url=f"http://127.0.0.1:{places.server_port}/"):
        settings = WorkcellManagerSettings(
            manager_name="bench",
            nodes={"flip": node},
            cold_start_delay=0,
            node_update_interval=0.5,
            scheduler_update_interval=0.5,
        )
        state = WorkcellStateHandler(
            workcell_settings=settings,
            nodes={"flip": node},
            cache_handler=InMemoryCacheHandler(),
            document_handler=InMemoryDocumentStorageHandler(),
        )
        engine = Engine(state, DataClient())
        steps = [
            StepDefinition(
                name=f"dose {vial}",
                node="flip",
                action="dose_powder",
                args={"powder": "sand", "target_mg": 12.0, "tolerance_mg": 3.0, "vial": vial, "vial_in_place": True},
            )
            for vial in ("B1", "B2")
        ]
        engine.update_active_nodes(state, update_info=True)
        workflow = create_workflow(
            workflow_def=WorkflowDefinition(name="two doses", steps=steps),
            workcell=state.get_workcell_info(),
            state_handler=state,
            json_inputs={},
            file_input_paths={},
            location_client=engine.location_client,
        )
        with state.wc_state_lock():
            state.set_active_workflow(workflow)
            state.enqueue_workflow(workflow.workflow_id)
        engine.spin()
        deadline = time.monotonic() + 300
        while not state.get_workflow(workflow.workflow_id).status.terminal and time.monotonic() < deadline:
            time.sleep(0.5)
        found = state.get_workflow(workflow.workflow_id)
        state.shutdown = True
        results = [step.result for step in found.steps]
        print(
            json.dumps(
                {
                    "completed": found.status.completed,
                    "steps": [str(step.status.value) for step in found.steps],
                    "errors": [[error.message for error in result.errors] for result in results if result],
                }
            )
        )


main(sys.argv[1])
