#!/usr/bin/env python3
"""Golden outputs: what a dozen commands print and store, with identifiers and times masked.

    python3 .ci/golden.py record     writes .ci/golden.sha256 from the built program (FLIP_BIN)
    python3 .ci/golden.py check      compares with it; what differs is left in target/golden for `diff`

A move of code must change nothing here. The lines of a training hold on the kind of processor that recorded them:
libtorch picks its kernels by it.
"""
import hashlib
import json
import os
import pathlib
import re
import shutil
import sqlite3
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parent.parent
FLIP = os.environ.get("FLIP_BIN", str(ROOT / "target/release/flip"))
SUMS = ROOT / ".ci/golden.sha256"
OUT = ROOT / "target/golden"

UUID = re.compile(r"[0-9a-f]{8}-[0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{12}")
TIME = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d(\.\d+)?)?( ?UTC|Z|\+00:00)?")
# Milliseconds since 1970, from 2023 to 2033.
EPOCH = re.compile(r"\b1[7-9]\d{11}\b")
# Hashes of the audit trail hold times; those of sets and policies (16 and 12 digits in their names) do not.
CHAIN = re.compile(r"\b[0-9a-f]{64}\b")
# Measured with a clock.
CLOCKED = re.compile(r'(\\?"(?:seconds|wall_s)\\?": ?|<dt>Run time</dt><dd>)[-+.\de]+')


def masked(text, folder):
    """`text` without what differs from run to run."""
    text = text.replace(str(folder), "FOLDER")
    known = {}
    text = UUID.sub(lambda found: known.setdefault(found[0], f"ID{len(known) + 1}"), text)
    for pattern, word in [(TIME, "TIME"), (EPOCH, "EPOCH"), (CHAIN, "HASH")]:
        text = pattern.sub(word, text)
    return CLOCKED.sub(r"\1CLOCK", text)


def stored(database):
    """Every row of every table, as JSON lines: what is in it, not in which order it came."""
    rows = []
    with sqlite3.connect(f"file:{database}?mode=ro", uri=True) as connection:
        names = connection.execute("SELECT name FROM sqlite_master WHERE type = 'table' ORDER BY name").fetchall()
        for (name,) in names:
            if name.startswith(("sqlite_", "_sqlx", "Jobs", "Workers")):
                continue
            cursor = connection.execute(f'SELECT * FROM "{name}"')
            columns = [column[0] for column in cursor.description]
            for row in cursor:
                values = {key: value.hex() if isinstance(value, bytes) else value for key, value in zip(columns, row)}
                # How many times progress was reported depends on the clock.
                values.pop("seq" if name in ("event", "job") else None, None)
                rows.append(f"{name} {json.dumps(values, sort_keys=True)}")
    return "\n".join(rows) + "\n"


def outputs(folder):
    """Name and text of each output."""
    data = folder / "data"

    def flip(*words, read=None):
        done = subprocess.run([FLIP, *words, "--data-dir", str(data)], capture_output=True, text=True, cwd=ROOT)
        if done.returncode != 0:
            sys.exit(f"flip {' '.join(words)}: {done.stderr}")
        return done.stdout if read is None else pathlib.Path(read).read_text()

    yield "repose", flip("heap", "--seed", "1", "--json")
    yield "repose_mechanism", flip("heap", "--seed", "2", "--extension", "size_spread=0.2", "--json")
    yield "observe", flip("observe", "shake_mass:pitch_deg=30,shake_mm=4", "flow_time:mass_g=20,orifice_mm=2.54", "--json")
    yield "calibrate", flip("calibrate", "--powder", "sand", "--method", "sequential", "--sets", "2", "--seed", "3", "--json")
    yield "calibrate_paper", flip("calibrate", "--powder", "salt", "--method", "paper", "--sets", "1", "--seed", "1", "--json")
    policies = flip("policy", "list", "--json")
    yield "policies", policies
    shipped = json.loads(policies)["items"][0]["id"]
    yield "infer", flip("policy", "infer", "--policy", shipped, "--reading-mg", "0", "--target-mg", "15", "--pitch-deg", "0", "--json")
    controllers = ["--controllers", "paced,pid,fuzzy,fixed,dispenser", "--powders", "sand", "--targets-mg", "5"]
    yield "evaluate", flip("evaluate", *controllers, "--repeats", "1", "--seed", "4", "--json")
    trained = flip("train", "--powders", "sand", "--episodes", "40", "--surrogate-episodes", "32", "--seed", "1", "--json")
    yield "train", trained
    policy = json.loads(trained)["policy"]
    flip("policy", "export", "--policy", policy, "--out", str(folder / "policy"))
    yield "train_policy", hashlib.sha256((folder / "policy").read_bytes()).hexdigest()[:32]
    yield "weigh", flip("weigh", "--powder", "sand", "--target-mg", "10", "--seed", "5", "--json")
    with sqlite3.connect(data / "flip.db") as connection:
        ((weighing,),) = connection.execute("SELECT id FROM weighing").fetchall()
    yield "certificate", flip("audit", "certificate", "--weighing", weighing, "--out", str(folder / "page"), read=folder / "page")
    flip("audit", "export", "--format", "csv", "--out", str(folder / "audit.csv"))
    yield "audit", (folder / "audit.csv").read_text()
    for name in ["humidity", "nothing"]:
        asked = ["--measurements", f"examples/campaigns/{name}.csv", "--seed", "1", "--budget-runs", "0", "--simulations", "199"]
        flip("discover", *asked, "--out", str(folder / name))
        for file in ["report.json", "report.html", "predict.csv"]:
            yield f"discover_{name}_{file}", (folder / name / file).read_text()
    yield "measurements", flip("measurements", "export")
    yield "stored", stored(data / "flip.db")


def main():
    wanted = {}
    if sys.argv[1:] == ["check"]:
        wanted = dict(reversed(line.split()) for line in SUMS.read_text().splitlines())
    elif sys.argv[1:] != ["record"]:
        sys.exit(__doc__)
    shutil.rmtree(OUT, ignore_errors=True)
    OUT.mkdir(parents=True)
    sums, wrong = {}, []
    with tempfile.TemporaryDirectory() as folder:
        for name, text in outputs(pathlib.Path(folder)):
            text = masked(text, folder)
            (OUT / name).write_text(text)
            sums[name] = hashlib.sha256(text.encode()).hexdigest()
            same = not wanted or wanted.get(name) == sums[name]
            wrong += [] if same else [name]
            print(f"{name}: {len(text)} characters{'' if same else ', DIFFERENT'}", flush=True)
    if wanted:
        sys.exit(f"different: {', '.join(wrong)} (target/golden)" if wrong else 0)
    SUMS.write_text("".join(f"{value}  {name}\n" for name, value in sums.items()))


main()
