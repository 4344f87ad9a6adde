#!/usr/bin/env python3
"""Builds and runs every test: `python3 .ci/tests.py [NAME ...]`, only suites whose name contains a NAME if any is given.

Suites that talk to emulated devices, services and a browser within deadlines run one after another. They mostly wait; what
they leave of the processor goes to the suites that only compute, two at a time in the scheduler's idle class, which gives way at once.
The store's, the application's, the interfaces' and that of kills run on SQLite, and once more on a private PostgreSQL.
Every suite's output is in target/test/SUITE.log.
"""
import collections
import concurrent.futures
import json
import os
import pathlib
import re
import shutil
import subprocess
import sys
import threading
import time

ROOT = pathlib.Path(__file__).resolve().parent.parent
TARGET = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
LOGS = ROOT / "target/test"
# Examples are compiled by `make lint`, flip-python with its wheel by `tests/clients/test_python.py`.
CARGO = ["cargo", "test", "--locked", "--workspace", "--exclude", "flip-experiments", "--exclude", "flip-python", "--lib", "--bins", "--tests"]

# Suites that also run on PostgreSQL; there without those tests that compute most of the time, whatever the database.
DATABASE = {
    "flip_store": [],
    "app": ["calibration::", "limits::", "simulator::", "spoons::", "training"],
    "api": ["balance::", "characterisations::", "comparison::", "films::", "investigations::", "simulators::", "stop::three_hundred_pollers"],
    "kills": [],
}
ON_POSTGRES = "_on_postgresql"
# Suites that only compute, the longest first.
COMPUTE = ["physics", "discovery", "flip_discover", "flip_sim", "flip_learn", "training", "flip_grains", "flip_policy", "flip_cuda", "flip_core"]
# A niceness of 19 is not enough: a balance that wakes may then wait for milliseconds.
IDLE = ["chrt", "--idle", "0"] if shutil.which("chrt") else ["nice", "-n", "19"]
# Tests that run at a time in a suite in which they mostly wait.
THREADS = {"flip_bench": 4}
SLOWEST = 10
# Tests that take minutes are ignored with that as the reason, except by `make test-long`.
LONG = ["--include-ignored"] if os.environ.get("FLIP_LONG") else []


def built():
    """The suites that cargo builds: name, command, folder."""
    done = subprocess.run([*CARGO, "--no-run", "--timings", "--message-format=json-render-diagnostics"], cwd=ROOT, stdout=subprocess.PIPE)
    if done.returncode != 0:
        sys.exit(done.returncode)
    for line in done.stdout.splitlines():
        message = json.loads(line)
        if message.get("executable") and message["profile"]["test"]:
            name, kind = message["target"]["name"], message["target"]["kind"][0]
            folder = pathlib.Path(message["manifest_path"]).parent
            # `--report-time` is unstable, and the slowest tests are worth it.
            threads = ["--test-threads", str(THREADS[name])] if name in THREADS else []
            # What a test prints is shown although it passes: it says why it was skipped.
            command = [message["executable"], "-Zunstable-options", "--report-time", "--show-output", *LONG, *threads]
            yield (f"{name}_{kind}" if kind == "bin" else name), command, folder
            if name in DATABASE and kind != "bin":
                left_out = [word for test in DATABASE[name] for word in ("--skip", test)]
                yield f"{name}{ON_POSTGRES}", ["env", "FLIP_TEST_DATABASE=postgres", *command, *left_out], folder
    page = {"FLIP_BIN": str(TARGET / "debug/flip")}
    yield "page", ["env", *(f"{name}={value}" for name, value in page.items()), "npm", "test"], ROOT / "web"
    yield "docs", ["make", "docs"], ROOT
    yield "clients", ["env", *(f"{name}={value}" for name, value in page.items()), sys.executable, "-m", "unittest", "discover", "-v", "tests/clients"], ROOT


def run(name, command, folder):
    """Runs a suite and returns its exit status, its seconds, its processor time, how many tests passed, and (seconds, test) of each."""
    log = LOGS / f"{name}.log"
    paths = [str(ROOT / ".libtorch/lib"), os.environ.get("LD_LIBRARY_PATH", "")]
    environment = {
        **os.environ,
        "RUSTC_BOOTSTRAP": "1",
        "CARGO_MANIFEST_DIR": str(folder),
        "LD_LIBRARY_PATH": ":".join(filter(None, paths)),
    }
    if name in ("clients", "docs", "page"):
        del environment["RUSTC_BOOTSTRAP"]
    start = time.monotonic()
    with log.open("wb") as out:
        process = subprocess.Popen(command, cwd=folder, env=environment, stdout=out, stderr=subprocess.STDOUT)
        _, status, used = os.wait4(process.pid, 0)
    text = log.read_text(errors="replace")
    passed = sum(int(n) for n in re.findall(r"^test result: \w+\. (\d+) passed", text, re.M))
    passed += sum(int(n) for n in re.findall(r"^\S+ pass (\d+)$", text, re.M))
    passed += len(re.findall(r"(?:^|\.\.\. )ok$", text, re.M)) if name == "clients" else 0
    times = re.findall(r"^test (.+) \.\.\. .*<([\d.]+)s>", text, re.M)
    times += [(test, float(ms) / 1000) for test, ms in re.findall(r"^ *✔ (.+) \(([\d.]+)ms\)$", text, re.M)]
    return status, time.monotonic() - start, used.ru_utime + used.ru_stime, passed, [(float(seconds), f"{name}: {test}") for test, seconds in times]


def main():
    names = sys.argv[1:]
    LOGS.mkdir(parents=True, exist_ok=True)
    clients = None
    if not names or any(it in "clients" for it in names):
        # Their packages come over the network while the compiler needs the processor.
        clients = subprocess.Popen(["nice", "-n", "19", sys.executable, "tests/clients/prepare.py"], cwd=ROOT)
    suites = {name: (command, folder) for name, command, folder in built() if not names or any(n in name for n in names)}
    results, speak = {}, threading.Lock()

    def work(name, prefix=()):
        command, folder = suites[name]
        results[name] = status, seconds, used, passed, _ = run(name, [*prefix, *command], folder)
        with speak:
            print(f"{name}: {passed} passed" + ("" if status == 0 else ", FAILED") + f", {seconds:.0f} s, {used:.0f} s of a processor", flush=True)
            if status != 0:
                print((LOGS / f"{name}.log").read_text(errors="replace"), flush=True)

    with concurrent.futures.ThreadPoolExecutor(2) as pool:
        computing = [pool.submit(work, name, IDLE) for name in COMPUTE if name in suites]
        for name in suites:
            if name == "clients" and clients:
                clients.wait()
            if name not in COMPUTE:
                work(name)
        for suite in computing:
            suite.result()
    print(f"the {SLOWEST} slowest tests:")
    for seconds, test in sorted((it for result in results.values() for it in result[4]), reverse=True)[:SLOWEST]:
        print(f"{seconds:7.1f} s  {test}")
    failed = [name for name, result in results.items() if result[0] != 0]
    page, others = (results.get(name, (0, 0, 0, 0))[3] for name in ("page", "clients"))
    total = sum(result[3] for result in results.values())
    on_postgres = sum(result[3] for name, result in results.items() if name.endswith(ON_POSTGRES))
    on_sqlite = sum(result[3] for name, result in results.items() if name in DATABASE)
    print(f"of the database: {on_sqlite} on SQLite, {on_postgres} on PostgreSQL")
    print(f"tests passed: {total} (Rust {total - page - others}, page {page}, others' clients {others})")
    logs = {name: (LOGS / f"{name}.log").read_text(errors="replace") for name in results}
    left_out = sum(int(n) for text in logs.values() for n in re.findall(r"; (\d+) ignored", text))
    print(f"left to `make test-long`, because they take minutes: {left_out}")
    for name, text in logs.items():
        for reason, count in collections.Counter(re.findall(r"(?:^|\.\.\. )skipped: (.+)$", text, re.M)).items():
            print(f"skipped in {name}, counted as passed: {count}: {reason}")
    if failed:
        sys.exit(f"failed: {', '.join(failed)}; see target/test/NAME.log")


if __name__ == "__main__":
    main()
