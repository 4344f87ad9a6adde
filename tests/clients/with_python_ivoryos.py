"""Weighs through a running ivoryOS: `with_python_ivoryos.py URL TOKEN POWDER`. Prints one JSON document.

Called with a port alone, it is that ivoryOS.
"""

import json
import os
import re
import socket
import subprocess
import sys
import tempfile
import time
from importlib.metadata import version

import httpx

from flip_powder.ivoryos import doser

if len(sys.argv) == 2:
    import ivoryos

    balance = doser()
    ivoryos.run(__name__, host="127.0.0.1", port=int(sys.argv[1]), debug=False)
    sys.exit()

url, token, powder = sys.argv[1:]
found: dict[str, object] = {"ivoryos": version("ivoryos")}
with socket.socket() as free:
    free.bind(("127.0.0.1", 0))
    port = free.getsockname()[1]
environment = {**os.environ, "FLIP_URL": url, "FLIP_TOKEN": token}
with tempfile.TemporaryDirectory() as folder:
    command = [sys.executable, __file__, str(port)]
    process = subprocess.Popen(command, cwd=folder, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        page = httpx.Client(base_url=f"http://127.0.0.1:{port}/ivoryos", follow_redirects=True, timeout=120)
        for _ in range(300):
            try:
                page.get("/auth/login")
                break
            except httpx.TransportError:
                time.sleep(0.2)
        person = {"username": "ada", "password": "secret-1"}
        page.post("/auth/signup", data=person)
        page.post("/auth/login", data=person)
        methods = page.get("/instruments/", headers={"accept": "application/json"}).json()["deck.balance"]
        found["methods"] = sorted(methods)
        found["offers_powders"] = "Powders" in methods["dose"]["signature"]
        form = page.get("/instruments/deck.balance").text
        found["form"] = [bool(re.search(word, form)) for word in ("dose", "target_mg")]

        def run(method: str, **arguments: str) -> dict:
            return page.post("/instruments/deck.balance", json={"hidden_name": method, **arguments}).json()

        dose = run("dose", powder=powder, target_mg="12", tolerance_mg="3", vial="B1")
        found["dose"] = [dose["success"], abs(float(dose["output"]) - 12.0) < 4.0]
        found["angle"] = run("angle_of_repose", powder=powder)["output"] > 10.0
        found["state"] = run("bench_state")["output"]
        refused = run("dose", powder="semolina", target_mg="8")
        found["refused"] = [refused["success"], "calibrate" in str(refused["output"])]
    finally:
        process.terminate()
        process.wait(20)
print(json.dumps(found))
