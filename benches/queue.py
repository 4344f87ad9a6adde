"""From POST to running, and what an idle service asks of its database.

    python3 benches/queue.py target/release/flip

Starts `flip serve` in a folder of its own. Counts its statements while it has nothing to do; then
asks for calibrations one after another, each at another moment, and cancels each once it runs.
"""

import json
import os
import random
import re
import statistics
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections import Counter
from datetime import datetime

IDLE_S = 20
JOBS = 60


def ask(method, path, body=None):
    data = None if body is None else json.dumps(body).encode()
    headers = {"authorization": f"Bearer {TOKEN}", "content-type": "application/json"}
    request = urllib.request.Request(URL + path, data, headers, method=method)
    with urllib.request.urlopen(request) as answer:
        return json.load(answer)


def until(job, *states):
    while True:
        found = ask("GET", f"/v1/jobs/{job}")
        if found["state"] in states:
            return found
        time.sleep(0.002)


def latency_ms(seed):
    body = {"repose_deg": 36, "method": "sequential", "particles": 100, "seed": seed}
    job = ask("POST", "/v1/calibrations", body)["id"]
    until(job, "running", "succeeded")
    ask("POST", f"/v1/jobs/{job}/cancel")
    ended = until(job, "cancelled", "succeeded")
    created, started = (datetime.fromisoformat(ended[at]) for at in ("created_at", "started_at"))
    return 1000 * (started - created).total_seconds()


with tempfile.TemporaryDirectory() as folder:
    log = open(f"{folder}/log", "w+")
    command = [sys.argv[1], "serve", "--data-dir", f"{folder}/data", "--listen", "127.0.0.1:0"]
    command += ["--log-format", "json"]
    environment = {**os.environ, "FLIP_LOG": "warn,sqlx=debug"}
    pipes = {"stdout": subprocess.PIPE, "stderr": log, "text": True}
    served = subprocess.Popen(command, env=environment, **pipes)
    try:
        URL = re.search(r"http://\S+", served.stdout.readline()).group()
        TOKEN = re.search(r"flip_\w+", served.stdout.readline()).group()
        time.sleep(2)
        start = log.seek(0, 2)
        time.sleep(IDLE_S)
        log.seek(start)
        found = Counter(
            json.loads(line)["summary"] for line in log.read().splitlines() if '"sqlx::query"' in line
        )
        print(f"idle: {sum(found.values()) / IDLE_S:.2f} statements/s")
        for summary, n in found.most_common():
            print(f"  {n / IDLE_S:6.2f}  {summary}")
        times = []
        for seed in range(JOBS):
            time.sleep(random.Random(seed).uniform(0, 0.5))
            times.append(latency_ms(seed))
        times.sort()
        middle, late = statistics.median(times), times[int(0.95 * JOBS)]
        print(f"from POST to running: median {middle:.0f} ms, 95 % {late:.0f} ms, worst {times[-1]:.0f} ms")
    finally:
        served.terminate()
        served.wait()
