"""The usual optimisers on the product's calibration task. usage: baselines.py --out DIR [--methods M,..] [--seeds N,..] ...

Each method searches the published box for parameter sets whose simulated angle of repose is a powder's, with as many heaps a powder as the
product's emulator takes: 290 for five powders. What it minimises is |angle of one heap - target|. The ten evaluated sets of least own error
are then verified as the product verifies its own: fresh heaps with seeds that the search has not seen, |mean over the heaps - target|.

A run is one method, powder and seed. DIR/runs.jsonl gets a line for each when it ends, and what is there already is not run again; when all
that was asked for is there, DIR/results.json and DIR/table.md are written. They depend on neither the workers nor the order of the runs.

A machine without a network gets its packages as a folder and PYTHONPATH=FOLDER: all of them by `pip install --target FOLDER -r
requirements.txt` under the same version of Python, or by `run.sh vendor FOLDER` those that a scientific Python usually lacks.
"""

import argparse
import hashlib
import json
import math
import os
import platform
import re
import signal
import statistics
import subprocess
import sys
import tempfile
import warnings
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import suppress
from importlib.metadata import version
from multiprocessing import active_children, get_context
from pathlib import Path

import numpy as np
import optuna
from scipy.stats import norm, qmc
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

with warnings.catch_warnings():
    # It regrets that there is no matplotlib.
    warnings.simplefilter("ignore")
    import cma

# What a heap without an angle counts as, degrees: more than heaps miss their target by, not so much more that it is all a model sees.
REFUSED_DEG = 60.0
# What the table counts: sets below the first by their own error, sets within the second (the product's tolerance) when verified.
OWN_DEG, VERIFIED_DEG = 1.0, 0.5

ROOT = Path(__file__).resolve().parents[2]
TARGET = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
FLIP = os.environ.get("FLIP_BIN", str(TARGET / "release" / "flip"))
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "RAYON_NUM_THREADS")


def flip(*arguments):
    """Exit status and stdout. Status 1 is for the caller to judge, anything else but 0 is an error here."""
    done = subprocess.run([FLIP, *arguments], capture_output=True, text=True)
    if done.returncode not in (0, 1):
        raise RuntimeError(f"{FLIP} {' '.join(arguments)}: status {done.returncode}\n{done.stderr.strip()}")
    return done.returncode, done.stdout


def box():
    """Lower and upper bound of each parameter by key, in the product's order. Its help is made from the table of bounds."""
    _, text = flip("heap", "--help")
    found = re.findall(r"--([a-z-]+) <X> .*? ([\d.]+) to ([\d.]+)(?: \S+)? \[default", " ".join(text.split()))
    if len(found) != 9:
        raise RuntimeError(f"`flip heap --help` names {len(found)} parameters, not nine")
    return {flag.replace("-", "_"): (float(lower), float(upper)) for flag, lower, upper in found}


def targets():
    """Measured angle of each published powder, degrees, by powder: from a calibration that is told to try once."""
    with tempfile.TemporaryDirectory() as folder:
        once = "--sets 1 --trials-max 1 --verify-repeats 1 --readings 1 --particles 200 --json".split()
        status, text = flip("calibrate", "--data-dir", folder, "--powder", "all", "--method", "paper", *once)
    if status:
        raise RuntimeError(f"`flip calibrate` does not tell the powders' angles: {text}")
    return {powder["powder"]: powder["target_deg"] for powder in json.loads(text)["powders"]}


def pour(parameters, seed, heaps, settings):
    """Angles of those of the heaps that have one, degrees, and the simulator's version (none if no heap has an angle)."""
    counts = [f"--{name}={settings[name]}" for name in ("readings", "particles")]
    flags = [f"--{key.replace('_', '-')}={value}" for key, value in parameters.items()]
    status, text = flip("heap", "--json", f"--seed={seed}", f"--repeats={heaps}", *counts, *flags)
    document = json.loads(text)
    if status == 0:
        return [heap["tip_deg"] for heap in document["heaps"]], document["simulator"]
    message = document["error"]["message"]
    # Only this is an answer; a broken installation must not become a table of refusals.
    if not message.startswith("no heap has an angle of repose"):
        raise RuntimeError(f"flip heap: {message}")
    return [], None


def derive(*path):
    """A seed for one purpose, 1 to 2^31 - 1: what every library takes; to one of them 0 means the clock."""
    digest = hashlib.sha256("/".join(map(str, path)).encode()).digest()
    return int.from_bytes(digest[:8], "big") % (2**31 - 1) + 1


class Spent(Exception):
    """The budget is."""


class Search:
    """The objective over the unit cube, and the memory of every evaluation."""

    def __init__(self, run, bounds, target, settings):
        self.run, self.bounds, self.target, self.settings = run, bounds, target, settings
        self.evaluations = []

    def __call__(self, point):
        if len(self.evaluations) == self.settings["budget"]:
            raise Spent
        sides = zip(self.bounds.items(), np.clip(point, 0.0, 1.0), strict=True)
        # Six digits, as the product rounds: what is written is what was simulated.
        parameters = {key: float(f"{low + x * (high - low):.6g}") for (key, (low, high)), x in sides}
        seed = derive("search", *self.run, len(self.evaluations))
        tips, _ = pour(parameters, seed, 1, self.settings)
        tip = tips[0] if tips else None
        error = None if tip is None else abs(tip - self.target)
        self.evaluations.append({"parameters": parameters, "seed": seed, "tip_deg": tip, "own_error_deg": error})
        return REFUSED_DEG if error is None else error


def low_discrepancy(count, dimensions, seed):
    """The first points of a scrambled Sobol sequence, which is only balanced when drawn by a power of two."""
    return qmc.Sobol(dimensions, rng=seed).random_base2(math.ceil(math.log2(max(count, 1))))[:count]


def sobol(search, budget, dimensions, seed):
    for point in low_discrepancy(budget, dimensions, seed):
        search(point)


def cma_es(search, budget, dimensions, seed):
    """With the library's population, bounds and BIPOP restarts; each start is random, a quarter of the box wide."""
    rng = np.random.default_rng(seed)
    options = {"bounds": [0, 1], "seed": seed, "verbose": -10, "verb_log": 0}
    cma.fmin2(search, lambda: rng.random(dimensions), 0.25, options, restarts=budget, bipop=True)


def tpe(search, budget, dimensions, seed):
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=seed))
    study.optimize(lambda trial: search([trial.suggest_float(str(k), 0, 1) for k in range(dimensions)]), n_trials=budget)


def gp_ei(search, budget, dimensions, seed, initial=10, pool=2048, near=512):
    """Expected improvement on the least mean that the model has at a point seen (the least error seen is luck), over random points and
    some around that one. Matern 5/2 with a length for each parameter, and white noise."""
    rng = np.random.default_rng(seed)
    points = list(low_discrepancy(min(initial, budget), dimensions, seed))
    errors = [search(point) for point in points]
    lengths = Matern(np.ones(dimensions), (0.1, 10.0), nu=2.5)
    kernel = ConstantKernel(1.0, (0.05, 20.0)) * lengths + WhiteKernel(0.1, (1e-3, 1.0))
    while True:
        scaled = (np.array(errors) - np.mean(errors)) / max(np.std(errors), 1e-9)
        model = GaussianProcessRegressor(kernel, n_restarts_optimizer=2, random_state=seed)
        with warnings.catch_warnings():
            # A length at its bound says that a parameter does nothing, and some do nothing.
            warnings.simplefilter("ignore", ConvergenceWarning)
            model.fit(points, scaled)
        seen = model.predict(points)
        around = points[seen.argmin()] + 0.1 * rng.standard_normal((near, dimensions))
        candidates = np.vstack([rng.random((pool, dimensions)), np.clip(around, 0.0, 1.0)])
        mean, sd = model.predict(candidates, return_std=True)
        # The library's deviation holds the noise of a heap, which is nothing to be gained.
        sd = np.sqrt(np.maximum(sd**2 - model.kernel_.k2.noise_level, 1e-12))
        gap = seen.min() - mean
        gain = gap * norm.cdf(gap / sd) + sd * norm.pdf(gap / sd)
        points.append(candidates[gain.argmax()])
        errors.append(search(points[-1]))


METHODS = {"sobol": sobol, "cma-es": cma_es, "tpe": tpe, "gp-ei": gp_ei}


def perform(run, bounds, target, settings):
    """One run: search, choose, verify. The line of runs.jsonl."""
    method, powder, seed = run
    search = Search(run, bounds, target, settings)
    with suppress(Spent):
        METHODS[method](search, settings["budget"], len(bounds), derive("method", *run))
    if len(search.evaluations) != settings["budget"]:
        raise RuntimeError(f"{method} stopped after {len(search.evaluations)} evaluations")
    angles = [(e["own_error_deg"], k) for k, e in enumerate(search.evaluations) if e["own_error_deg"] is not None]
    sets = []
    for own, k in sorted(angles)[: settings["sets"]]:
        heap_seed, heaps = derive("verification", *run, k), settings["verify_heaps"]
        tips, _ = pour(search.evaluations[k]["parameters"], heap_seed, heaps, settings)
        # As in the product, a refused heap leaves a set unverified.
        error = abs(statistics.fmean(tips) - target) if len(tips) == heaps else None
        sets.append({"evaluation": k, "own_error_deg": own, "seed": heap_seed, "tips_deg": tips, "verified_error_deg": error})
    return {
        "method": method,
        "powder": powder,
        "seed": seed,
        "target_deg": target,
        "settings": settings,
        "versions": versions(),
        "evaluations": search.evaluations,
        "sets": sets,
    }


def versions():
    return {"python": platform.python_version()} | {name: version(name) for name in ("numpy", "scipy", "scikit-learn", "cma", "optuna")}


def stored(file, settings, measured):
    """Runs of these settings by method, powder and seed."""
    runs = {}
    for line in file.read_text().splitlines() if file.exists() else []:
        # The last line may be half written.
        with suppress(json.JSONDecodeError):
            run = json.loads(line)
            if run["settings"] == settings and run["target_deg"] == measured.get(run["powder"]):
                runs[run["method"], run["powder"], run["seed"]] = run
    return runs


def mean(values):
    values = [value for value in values if value is not None]
    return statistics.fmean(values) if values else None


def figures(run):
    """What a run says, in numbers; an error is none when there is no set to have it."""
    own = [found["own_error_deg"] for found in run["sets"]]
    verified = [found["verified_error_deg"] for found in run["sets"]]
    return {
        "own_error_deg": mean(own),
        "own_sets": sum(error < OWN_DEG for error in own),
        "verified_error_deg": mean(verified),
        "verified_sets": sum(error is not None and error <= VERIFIED_DEG for error in verified),
        "unverified_sets": verified.count(None),
        "refused_evaluations": sum(e["tip_deg"] is None for e in run["evaluations"]),
    }


def over_seeds(values):
    """Mean and standard deviation (n - 1) over the seeds."""
    values = [value for value in values if value is not None]
    return {"mean": mean(values), "sd": statistics.stdev(values) if len(values) > 1 else None}


def summary(method, powders, seeds, runs):
    at = {(powder, seed): figures(runs[method, powder, seed]) for powder in powders for seed in seeds}
    names = ["own_error_deg", "own_sets", "verified_error_deg", "verified_sets"]
    all_powders = {name: over_seeds([mean(at[p, s][name] for p in powders) for s in seeds]) for name in names}
    by_powder = {p: {name: over_seeds([at[p, s][name] for s in seeds]) for name in names} for p in powders}
    totals = {name: sum(run[name] for run in at.values()) for name in ("unverified_sets", "refused_evaluations")}
    return {"method": method, "seeds": len(seeds), **all_powders, "powders": by_powder, **totals}


def cell(value, digits=2):
    if value["mean"] is None:
        return "-"
    spread = "" if value["sd"] is None else f" ± {value['sd']:.{digits}f}"
    return f"{value['mean']:.{digits}f}{spread}"


def table(summaries, powders, settings):
    """Markdown."""

    of = f"of {settings['sets']}"
    header = ["method", "seeds", "own error deg", f"own error < {OWN_DEG:g} deg, {of}", "verified error deg"]
    header += [f"verified <= {VERIFIED_DEG:g} deg, {of}", *(f"{powder}: verified deg" for powder in powders)]
    lines = []
    for s in summaries:
        line = [s["method"], str(s["seeds"]), cell(s["own_error_deg"]), cell(s["own_sets"], 1)]
        line += [cell(s["verified_error_deg"]), cell(s["verified_sets"], 1)]
        lines.append(line + [cell(s["powders"][powder]["verified_error_deg"]) for powder in powders])
    heaps = f"{settings['verify_heaps']} heaps with fresh seeds, {settings['readings']} readings each"
    notes = [
        f"{settings['budget']} evaluations a powder, each one heap of {settings['particles']} grains, simulator {settings['simulator']};",
        f"of them the {settings['sets']} sets of least own error. Own error: |angle of the heap that chose the set - target|.",
        f"Verified error: |mean over {heaps} - target|.",
        "Numbers are means over sets, over powders where none is named, and over seeds; ± is the SD (n - 1) over seeds of such means.",
    ]
    for s in summaries:
        if s["unverified_sets"] or s["refused_evaluations"]:
            refused = f"{s['method']}: {s['refused_evaluations']} evaluations had no angle"
            notes.append(f"{refused}; {s['unverified_sets']} sets had a refused heap and are in no mean of the verified error.")
    rows = ["| " + " | ".join(line) + " |" for line in [header, *lines]]
    return "\n".join([rows[0], "|" + "---|" * len(header), *rows[1:], "", *notes, ""])


def arguments():
    def names(text):
        return text.split(",")

    def numbers(text):
        return [int(number) for number in text.split(",")]

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0], allow_abbrev=False)
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--methods", type=names, default=list(METHODS), metavar="M,..", help=", ".join(METHODS))
    parser.add_argument("--powders", type=names, metavar="P,..", help="default: the published five")
    parser.add_argument("--seeds", type=numbers, default=[1, 2, 3, 4, 5], metavar="N,..", help="default: 1,2,3,4,5")
    parser.add_argument("--budget", type=int, default=58, metavar="N", help="evaluations of a search; default 58")
    parser.add_argument("--sets", type=int, default=10, metavar="N", help="sets verified; default 10")
    parser.add_argument("--verify-heaps", type=int, default=8, metavar="N", help="heaps of a set's verification; default 8")
    parser.add_argument("--readings", type=int, default=4, metavar="N", help="readings of every heap; default 4")
    parser.add_argument("--particles", type=int, default=2000, metavar="N", help="grains of every heap; default 2000")
    parser.add_argument("--workers", type=int, default=os.cpu_count(), metavar="N", help="default: one for each core")
    return parser, parser.parse_args()


def main():
    # Before the workers start, which inherit it: one run, one core.
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    parser, asked = arguments()
    bounds, measured = box(), targets()
    powders = asked.powders or list(measured)
    for name, given, known in (("method", asked.methods, METHODS), ("powder", powders, measured)):
        for unknown in set(given) - set(known):
            parser.error(f"no such {name}: {unknown} ({', '.join(known)})")
    settings = {name: getattr(asked, name) for name in ("budget", "sets", "verify_heaps", "readings", "particles")}
    for name, value in settings.items():
        if value < 1:
            parser.error(f"--{name.replace('_', '-')} must be at least 1")
    _, settings["simulator"] = pour({}, 1, 1, settings)

    asked.out.mkdir(parents=True, exist_ok=True)
    file = asked.out / "runs.jsonl"
    runs = stored(file, settings, measured)
    wanted = [(method, powder, seed) for method in asked.methods for powder in powders for seed in asked.seeds]
    missing = [run for run in wanted if run not in runs]
    with file.open("a+b") as log, ProcessPoolExecutor(asked.workers, get_context("spawn")) as pool:
        if log.tell() and (log.seek(-1, os.SEEK_END), log.read(1))[1] != b"\n":
            log.write(b"\n")
        futures = {pool.submit(perform, run, bounds, measured[run[1]], settings): run for run in missing}
        try:
            for done in as_completed(futures):
                run = futures[done]
                runs[run] = done.result()
                log.write(json.dumps(runs[run]).encode() + b"\n")
                log.flush()
                print(f"{sum(r in runs for r in wanted)} of {len(wanted)}: {' '.join(map(str, run))}", file=sys.stderr)
        except BaseException:
            # Nobody would hear what the others are at, for minutes.
            pool.shutdown(wait=False, cancel_futures=True)
            for worker in active_children():
                worker.terminate()
            raise

    summaries = [summary(method, powders, asked.seeds, runs) for method in asked.methods]
    text = table(summaries, powders, settings)
    document = {"settings": settings, "bounds": bounds, "methods": summaries, "runs": [runs[run] for run in wanted]}
    (asked.out / "results.json").write_text(json.dumps(document, indent=1) + "\n")
    (asked.out / "table.md").write_text(text)
    print(text, end="")


if __name__ == "__main__":
    main()
