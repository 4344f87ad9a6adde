"""Control steps per second of spoons of simulated grains: FLIP's environment, the same doses stepped by a loop in Rust, and Newton.

A control step tilts the spoon by 8 degrees and shakes it by 8 mm, and ends when the powder rests. All play the first steps of an episode, from
a level spoon that has just been filled; filling it is not timed. Newton begins with FLIP's grains and plays as long as FLIP's mean step lasts
(newton_spoon.py). It has one process for each core, and one spoon in each, since Warp's processor backend uses one thread.

    run.sh [--repeats 3] [--spoons 16] [--particles 2500] [--steps 1] [--newton xpbd-100-4 xpbd-200-2 mpm-2000]
"""

import argparse
import json
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from newton_spoon import mean_overlap

from flip_powder.env import Level
from flip_powder.sim import ParameterSet, Spoon, step_all

HERE = pathlib.Path(__file__).resolve().parent
CORES = int(os.environ.get("RAYON_NUM_THREADS", os.cpu_count() or 1))
TILT_DEG, SHAKE_MM = 8.0, 8.0
#: The same as an action of the environment: times 8 degrees, and 0 to 16 mm.
ACTION = (TILT_DEG / 8.0, SHAKE_MM / 8.0 - 1.0)


class Row:
    """What is known of one simulator after its repeats."""

    def __init__(self, name, count):
        self.name, self.count = name, count
        self.wall, self.core, self.overlap = [], [], None

    def timed(self, play):
        wall, core = time.perf_counter(), time.process_time()
        play()
        self.add(time.perf_counter() - wall, time.process_time() - core)

    def add(self, wall, core):
        """Seconds for `count` control steps."""
        self.wall.append(wall)
        self.core.append(core)

    def line(self, step_s):
        rates = [self.count / wall for wall in self.wall]
        costs = [core / self.count for core in self.core]
        overlap = "" if self.overlap is None else f"{100 * self.overlap:.2f}"
        pace = statistics.median(rates) * step_s
        return f"| {self.name} | {spread(rates)} | {pace:.3g} | {spread(costs)} | {overlap} |"


def spread(values):
    """Median (least to most)."""
    return f"{statistics.median(values):.3g} ({min(values):.3g} to {max(values):.3g})"


def filled(asked):
    """Spoons as `flip_powder.sim` fills them; the grains of the first, its steps, and the overlap after them."""
    spoons = [Spoon(ParameterSet(), particles=asked.particles, seed=seed) for seed in range(asked.spoons)]
    snapshot = spoons[0].snapshot
    seconds = []
    for _ in range(asked.steps):
        poured = step_all(spoons, [(TILT_DEG, SHAKE_MM)] * asked.spoons)
        seconds.append(statistics.fmean(it.duration_s for it in poured))
    radius = float(snapshot.radii_mm[0])
    overlap = statistics.fmean(mean_overlap(it.snapshot.centres_mm, 2 * radius) for it in spoons)
    return snapshot.centres_mm, radius, [(TILT_DEG, SHAKE_MM, it) for it in seconds], overlap


class Newton:
    """Newton in a process for each core."""

    def __init__(self, solver, bed, steps):
        command = [sys.executable, str(HERE / "newton_spoon.py"), solver, str(bed)]
        where = {**os.environ, "OMP_NUM_THREADS": "1"}
        self.processes = [subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=where) for _ in range(CORES)]
        self.row = Row(f"Newton, {solver}", CORES * steps)
        self.versions = [self.said(it) for it in self.processes][0]

    @staticmethod
    def said(process):
        for line in process.stdout:
            if line.startswith("{"):
                return json.loads(line)
        raise RuntimeError(f"{process.args} ended with {process.wait()}")

    def play(self):
        begun = time.perf_counter()
        for process in self.processes:
            process.stdin.write("\n")
            process.stdin.flush()
        done = [self.said(it) for it in self.processes]
        self.row.add(time.perf_counter() - begun, sum(it["core_s"] for it in done))
        if "xpbd" in self.row.name:
            self.row.overlap = done[0]["overlap"]
        if done[0]["in_spoon"] < 0.9:
            raise RuntimeError(f"{self.row.name}: {done[0]['in_spoon']:.0%} of the grains are left in the spoon")

    def end(self):
        for process in self.processes:
            process.stdin.close()
            process.wait()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--spoons", type=int, default=16, help="of the environment and of the loop in Rust")
    parser.add_argument("--particles", type=int, default=2500, help="grains in each spoon")
    parser.add_argument("--steps", type=int, default=1, help="control steps of an episode, 1 to 10")
    parser.add_argument("--newton", nargs="*", default=["xpbd-100-4", "xpbd-200-2", "mpm-2000"], help="solvers of newton_spoon.py")
    asked = parser.parse_args()

    centres, radius, steps, overlap = filled(asked)
    step_s = statistics.fmean(seconds for _, _, seconds in steps)
    level = Level("grains", 34.0, [ParameterSet()])
    more = {"pouring": "simulator", "levels": [level], "box_share": 0.0, "particles": asked.particles}
    envs = gym.make_vec("FlipWeigh-v0", num_envs=asked.spoons, autoreset_mode=AutoresetMode.DISABLED, **more)
    block = np.full((asked.steps, asked.spoons, 2), ACTION, np.float32)
    doses, flat = envs.unwrapped._doses, block.reshape(-1, 2)

    def environment():
        for actions in block:
            envs.step(actions)

    count = asked.steps * asked.spoons
    loops = {Row("FLIP, loop in Rust", count): lambda: doses.native.run(flat, doses.arrays), Row("FLIP, environment", count): environment}
    for repeat in range(asked.repeats * 4):
        for row, play in loops.items():
            # No dose of this target ends before its last step.
            envs.reset(seed=repeat // 4, options={"target_mg": 1000.0})
            row.timed(play)
            row.overlap = overlap

    rows, versions = list(loops), {}
    with tempfile.TemporaryDirectory() as folder:
        bed = pathlib.Path(folder, "bed.npz")
        np.savez(bed, centres_mm=centres, radius_mm=radius, mass_ug=ParameterSet()["particle_mass_ug"], steps=steps)
        for solver in asked.newton:
            newton = Newton(solver, bed, asked.steps)
            for _ in range(asked.repeats):
                newton.play()
            newton.end()
            rows.append(newton.row)
            versions = newton.versions

    said = "".join(f", {name} {version}" for name, version in versions.items())
    print(f"\n{CORES} cores, {asked.particles} grains a spoon, {step_s:.3f} simulated s a step, {asked.repeats} repeats (FLIP: {asked.repeats * 4}){said}")
    print("| simulated by | steps/s, all cores | simulated s per s | core-s a step | mean overlap % of d |")
    print("|---|---|---|---|---|")
    for row in rows:
        print(row.line(step_s))
    rust, environment_row = rows[:2]
    more = 100 * (statistics.median(environment_row.core) / statistics.median(rust.core) - 1)
    print(f"\nthe environment over the loop in Rust, by the median core-s: {more:+.1f} %")
    print(f"load at the end: {' '.join(f'{it:.1f}' for it in os.getloadavg())}")


if __name__ == "__main__":
    main()
