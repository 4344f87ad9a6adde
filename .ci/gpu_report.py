#!/usr/bin/env python3
"""What a graphics card does, beside this machine's cores: `.ci/gpu_report.py target/release [part…]`.

What a part printed is kept in the folder DATA (target/gpu-report). A later call with the same programs, card and number of
cores prints it again, and goes on where trainings were stopped: all of it takes three quarters of an hour, and can be made in
pieces. `--again` measures the parts anew. Without a card it prints why there is nothing to measure.
"""
import argparse
import csv
import datetime
import hashlib
import json
import os
import pathlib
import re
import shutil
import subprocess
import sys
import time

ROOT = pathlib.Path(__file__).resolve().parent.parent
DATA = pathlib.Path(os.environ.get("DATA") or ROOT / "target/gpu-report").resolve()
CORES = len(os.sched_getaffinity(0))
PROGRAMS = ["flip", "emulator_rounds", "published_experiment", "weighing_gain", "examples/gpu_report", "examples/learner_report"]
# With fewer connections than trainings side by side, some wait for others' spoons.
CONNECTIONS = {"CUDA_DEVICE_MAX_CONNECTIONS": "32"}
DOSES = "evaluate --powders sand,salt,sugar --controllers paced,schedule --targets-mg 10,15 --repeats 20".split()
# Parts that go on where a call was stopped.
IN_PIECES = {"published", "feed-forward", "weighing-gain"}
# A launch of spoons tilted and shaken, at rest, and tilted and shaken of grains that turn, by `gpu_report quick`.
LAUNCHES = {"tilted and shaken": 4, "at rest": 1, "grains turn, tilted and shaken": 14}
WAVEFRONTS, CONFLICTS = (
    f"l1tex__data_{it}_mem_shared.sum" for it in ["pipe_lsu_wavefronts", "bank_conflicts_pipe_lsu"]
)
COUNTS = {
    "issue slots, while a multiprocessor works": "sm__inst_issued.sum.pct_of_peak_sustained_active",
    "issue slots": "sm__inst_issued.sum.pct_of_peak_sustained_elapsed",
    "shared memory's pipe": f"{WAVEFRONTS}.pct_of_peak_sustained_elapsed",
    "second-level cache": "lts__t_sectors.sum.pct_of_peak_sustained_elapsed",
    "the card's memory": "dram__throughput.avg.pct_of_peak_sustained_elapsed",
    "warps": "sm__warps_active.avg.pct_of_peak_sustained_active",
}


def release(name):
    return str(FOLDER / name)


def lines(command, folder, **environment):
    """Each line that a program prints; what it says beside that is in a file of the part."""
    command = [str(word) for word in command]
    with open(folder / "said.txt", "a") as said:
        print("$", *command, file=said, flush=True)
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=said, text=True, env={**os.environ, **environment})
        yield from (line.rstrip("\n") for line in process.stdout)
        if process.wait() != 0:
            last = (folder / "said.txt").read_text().splitlines()[-3:]
            raise RuntimeError("\n".join([f"{' '.join(command)} ended with {process.returncode}; {folder}/said.txt ends with", *last]))


def timed(name, arguments, folder, data):
    """A line with the time that a command of `flip` took, and its document."""
    began = time.monotonic()
    document = json.loads("\n".join(lines([release("flip"), *arguments, "--json", "--data-dir", data], folder)))
    return f"{name:36} {time.monotonic() - began:7.1f} s", document


def weighed(document):
    """The errors of an evaluation's controllers."""
    for row in document["summary"]:
        low, high = row["ci95"]
        yield f"  {row['controller']:10} {row['mae_mg']:.3f} mg, 95 % {low:.3f} to {high:.3f}, bias {row['bias_mg']:+.3f}"


def calibrated():
    """A data folder with quick calibrations of three powders, made once for these programs."""
    return once("calibrated", lambda folder: [
        timed(powder, ["calibrate", "--powder", powder, "--method", "sequential", "--sets", 4, "--tolerance-deg", 3,
                       "--particles", 600], folder, folder / "flip")
        for powder in ["sand", "sugar", "salt"]
    ]) / "flip"


def once(name, make):
    """A folder of DATA that several parts use, whole or not at all."""
    folder = DATA / name
    if read(folder / "programs") != KEY.program:
        unfinished = DATA / f"{name}.unfinished"
        shutil.rmtree(unfinished, ignore_errors=True)
        shutil.rmtree(folder, ignore_errors=True)
        unfinished.mkdir()
        make(unfinished)
        (unfinished / "programs").write_text(KEY.program)
        unfinished.rename(folder)
    return folder


def fresh(folder):
    """A data folder with the quick calibrations in which nothing else has been computed."""
    return shutil.copytree(calibrated(), folder / "flip")


def example(name, *arguments):
    return lambda folder: lines([release(f"examples/{name}"), *arguments], folder)


def limits(folder):
    ncu = shutil.which("ncu") or shutil.which("ncu", path="/usr/local/cuda/bin")
    if ncu is None:
        yield "skipped: Nsight Compute (ncu) is not installed, so nothing counts what a launch does"
        return
    metrics = ",".join([*COUNTS.values(), WAVEFRONTS, CONFLICTS])
    yield "% of the card's limit"
    for name, before in LAUNCHES.items():
        found = list(lines([ncu, "--csv", "-k", "regex:flip_spoons", "--launch-skip", before, "--launch-count", 1, "--metrics",
                            metrics, release("examples/gpu_report"), "quick"], folder))
        table = csv.DictReader(line for line in found if line.startswith('"'))
        counted = {row["Metric Name"]: float(row["Metric Value"].replace(",", "")) for row in table}
        if missing := {*COUNTS.values(), WAVEFRONTS, CONFLICTS} - counted.keys():
            raise RuntimeError("\n".join([f"ncu did not count {', '.join(sorted(missing))}; it says", *found[-3:]]))
        for what, metric in COUNTS.items():
            yield f"{name:32} {what:42} {counted[metric]:5.0f}"
        yield f"{name:32} {'of shared memory, bank conflicts':42} {100 * counted[CONFLICTS] / counted[WAVEFRONTS]:5.0f}"


def laws(folder):
    yield from lines([release("flip"), "validate", "--device", "cuda", "--data-dir", folder / "flip"], folder)


def doses(folder):
    data = fresh(folder)
    for name, arguments in {
        "240 doses, card": ["--device", "cuda"],
        "240 doses, cores": [],
        "240 doses at 20 us, card": ["--substep-us", 20, "--device", "cuda"],
    }.items():
        line, document = timed(name, [*DOSES, *arguments], folder, data)
        yield line
        yield from weighed(document)


def training(name, *device):
    def measure(folder):
        data = fresh(folder)
        line, document = timed(name, ["train", "--seed", 1, *device], folder, data)
        yield line
        beside = [*DOSES, "--policy", document["policy"], "--device", "cuda"]
        line, document = timed("240 doses beside its policy", beside, folder, data)
        yield line
        yield from weighed(document)

    return measure


def emulator(folder):
    yield from lines([release("emulator_rounds"), "240:240:1:4", 1, 300, "cuda"], folder)


def powders(folder):
    data = fresh(folder)
    for powder in ["salt", "sugar", "sand"]:
        what = "its emulator and ten sets" if powder == "salt" else "ten sets, by the same emulator"
        yield timed(f"{powder}: {what}", ["calibrate", "--powder", powder, "--device", "cuda"], folder, data)[0]


def demonstration(folder):
    demo = "demo --exit --listen 127.0.0.1:0 --seed 1 --device cuda".split()
    yield timed("demonstration from nothing", demo, folder, folder / "flip")[0]


def published(study):
    script = ROOT / ".ci/published_experiment.sh"

    def measure(folder):
        powders = once("powders-of-trainings", lambda folder: [*lines([script, FOLDER, "none"], folder, DATA=str(folder))])
        for calibration in powders.glob("*.json"):
            shutil.copy(calibration, folder)
        yield from lines([script, FOLDER, study], folder, DATA=str(folder))

    return measure


def gain(folder):
    inputs = {"DATA": str(folder / "flip"), "DEVICE": "cuda", "FLIP_BIN": release("flip"), **CONNECTIONS}
    return lines([release("weighing_gain")], folder, **inputs)


PARTS = {
    **{name: example("gpu_report", name) for name in ["speed", "repeats", "equivalence", "heaps", "launches"]},
    "limits": limits,
    "updates": example("learner_report"),
    "laws": laws,
    "doses": doses,
    "training": training("training, card", "--device", "cuda"),
    "training-on-cores": training("training, cores"),
    "emulator": emulator,
    "powders": powders,
    "demonstration": demonstration,
    "published": published("published"),
    "feed-forward": published("feed-forward"),
    "weighing-gain": gain,
}


class Key:
    """What a result is of: the programs, the card and the cores."""

    def __init__(self, card):
        contents = hashlib.sha256()
        for name in PROGRAMS:
            contents.update(pathlib.Path(release(name)).read_bytes())
        self.program = contents.hexdigest()[:12]
        self.whole = f"{card}; {CORES} CPU cores; programs {self.program}"


def read(path):
    return path.read_text() if path.exists() else None


def part(name, measure, again):
    """Prints a part, measured now or before; whether it could be measured."""
    folder = DATA / name
    kept, key = folder / "printed.txt", folder / "key.txt"
    if again or read(key) != KEY.whole:
        shutil.rmtree(folder, ignore_errors=True)
    if kept.exists():
        print(kept.read_text(), flush=True)
        return True
    if name not in IN_PIECES:
        shutil.rmtree(folder, ignore_errors=True)
    earlier = ", after a call that was stopped" if folder.exists() else ""
    folder.mkdir(exist_ok=True)
    key.write_text(KEY.whole)
    printed = []

    def tell(line):
        print(line, flush=True)
        printed.append(line)

    tell(f"== {name}, {datetime.datetime.now():%Y-%m-%d %H:%M}, {KEY.whole}")
    began = time.monotonic()
    try:
        for line in measure(folder):
            tell(line)
    except (RuntimeError, KeyError, ValueError) as error:
        print(f"failed: {error}", flush=True)
        return False
    tell(f"{name} took {time.monotonic() - began:.0f} s{earlier}\n")
    unfinished = folder / "printed.unfinished"
    unfinished.write_text("\n".join(printed))
    unfinished.rename(kept)
    return True


arguments = argparse.ArgumentParser(description=__doc__)
arguments.add_argument("programs", type=pathlib.Path, help="folder of the built programs")
arguments.add_argument("parts", nargs="*", help=f"some of {', '.join(PARTS)}; all of them if none is named")
arguments.add_argument("--again", action="store_true", help="measure these parts anew")
given = arguments.parse_args()
if unknown := set(given.parts) - set(PARTS):
    arguments.error(f"there is no part {', '.join(sorted(unknown))}: {', '.join(PARTS)}")
FOLDER = given.programs.resolve()
if missing := [name for name in PROGRAMS if not (FOLDER / name).exists()]:
    arguments.error(f"{FOLDER} has no {', '.join(missing)}: `make on-a-card` builds them in target/release")
DATA.mkdir(parents=True, exist_ok=True)
# Finds no launch to make: it names the card and ends, or says why there is none.
first = subprocess.run([release("examples/gpu_report"), "card"], stdout=subprocess.PIPE, text=True, check=True).stdout.strip()
if first.startswith("skipped"):
    print(first)
    sys.exit()
KEY = Key(re.split("[,;]", first)[0])
try:
    measured = [part(name, PARTS[name], given.again) for name in given.parts or PARTS]
except KeyboardInterrupt:
    sys.exit("stopped: the same call goes on")
sys.exit(0 if all(measured) else 1)
