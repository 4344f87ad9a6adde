"""The scene that every peer simulates, and the clock that times it.

A settled column of equal spheres is released on the plane z = 0 under gravity. Lengths in m, masses in kg, times in s.
A peer advances to START and then through windows of WINDOW, one for each line on stdin, so that several peers can take turns
window by window on the same machine. At the end of stdin it prints one JSON line. `run.sh` and `flip bench sim --peers` feed it.
"""

import json
import statistics
import sys
import time

import numpy as np

DIAMETER = 0.27e-3
MASS = 14.25e-9
GRAVITY = 9.81
FRICTION = 0.5
RESTITUTION = 0.5
START = 4e-3
WINDOW = 2e-3


def bed(path):
    """Centres, one `x,y,z` a line; array (N, 3)."""
    return np.loadtxt(path, delimiter=",", ndmin=2)


def mean_overlap(centres):
    """Mean overlap of the pairs that overlap, as a share of the diameter."""
    x = centres[np.argsort(centres[:, 2])]
    last = np.searchsorted(x[:, 2], x[:, 2] + DIAMETER)
    shares = []
    for i in range(len(x) - 1):
        distance = np.linalg.norm(x[i + 1 : last[i]] - x[i], axis=1)
        shares.append(1.0 - distance[distance < DIAMETER] / DIAMETER)
    shares = np.concatenate(shares) if shares else np.zeros(0)
    return float(shares.mean()) if len(shares) else 0.0


def peak_memory_mb():
    """Of this program, MiB. getrusage would tell the larger of this and of the program that started it."""
    with open("/proc/self/status") as status:
        return next(int(line.split()[1]) for line in status if line.startswith("VmHWM:")) / 1024


def measure(peer, version, dt, iterations, n, advance, centres):
    """Time `advance(steps)`, which returns when the steps are done; `centres()` gives the positions, array (n, 3)."""
    steps = round(WINDOW / dt)
    advance(steps)
    advance(round(START / dt) - steps)
    print("ready", flush=True)
    costs, overlaps = [], []
    for _ in sys.stdin:
        before = time.process_time()
        advance(steps)
        costs.append((time.process_time() - before) / (steps * dt))
        overlaps.append(mean_overlap(centres()))
        print("window", flush=True)
    middle = statistics.median(costs)
    print(
        json.dumps(
            {
                "peer": peer,
                "version": version,
                "particles": n,
                "dt_s": dt,
                "iterations": iterations,
                "windows": len(costs),
                "core_s_per_sim_s": {"median": middle, "min": min(costs), "max": max(costs)},
                "particle_steps_per_core_s": n / dt / middle,
                "overlap_mean": statistics.fmean(overlaps),
                "rss_mb": peak_memory_mb(),
            }
        ),
        flush=True,
    )
