"""The prior of the dispenser from steps of simulated spoons. usage: fit.py STEPS.csv [STEPS.csv ...] [--generations N]

STEPS.csv is what `cargo run --release --example shake_response` prints. The model is that of src/policy/dispenser.rs:

    G = slope width softplus((p + reach ln A - onset) / width), at most held
    mean of a shake = max(G - M, 0) (1 - exp(-(A / stroke)^bend))
    sqrt(mass) ~ t_4(sqrt(mean), floor^2 + scatter^2 mean)

with M what the spoon has lost before (vial and spilled). Onset, ln slope and ln stroke are each course's own, jointly normal over the courses.
CMA-ES looks for the numbers that all courses share, then expectation maximisation for the mean and covariance of those three. Prints them
as src/policy/dispenser.rs has them, and how predictions compare with what fell, each made before the step from the course's earlier steps.

Needs numpy, scipy and cma: benches/calibration/run.sh setup has them.
"""

import argparse
import csv
import math
import warnings

import numpy as np
from scipy.stats import norm, qmc

with warnings.catch_warnings():
    # It regrets that there is no matplotlib.
    warnings.simplefilter("ignore")
    import cma

# What a spoon holds at most, mg, and what keeps the root of no mass away from nothing.
HELD_MG, DUST_MG = 40.0, 0.005
# The last of the shared numbers before the search: bend, reach deg, width deg, floor, scatter.
SHARED = np.array([math.log(0.6), 2.0, math.log(1.0), math.log(0.2), math.log(0.4)])
# Onset deg, ln slope, ln stroke: mean and SD before the search.
OWN = np.array([5.0, 15.0, -0.3, 0.5, 3.0, 1.0])


def read(paths):
    """Pitch, amplitude (0 for none), mass in the vial and spilled, each of shape (courses, steps)."""
    courses = {}
    for path in paths:
        with open(path, newline="") as file:
            for row in csv.DictReader(file):
                numbers = [float(row[key]) for key in ("pitch_deg", "shake_mm", "poured_mg", "spilled_mg")]
                courses.setdefault((path, row["course"]), []).append(numbers)
    pitch, shake, poured, spilled = np.moveaxis(np.array(list(courses.values())), 2, 0)
    return pitch, np.where(shake < 0.9, 0.0, shake), poured, spilled


class Courses:
    def __init__(self, paths):
        self.pitch, self.shake, self.poured, spilled = read(paths)
        lost = self.poured + spilled
        self.lost = np.cumsum(lost, 1) - lost

    def steps(self, shared, own):
        """For each step its shaken courses, the means under each guess and the logarithms of the likelihoods."""
        bend, width, floor, scatter = np.exp(shared[[0, 2, 3, 4]])
        onset, slope, stroke = own[:, 0], np.exp(own[:, 1]), np.exp(own[:, 2])
        for t in range(self.pitch.shape[1]):
            shaken = self.shake[:, t] > 0
            amplitude = np.where(shaken, self.shake[:, t], 1.0)[:, None]
            x = (self.pitch[:, t][:, None] + shared[1] * np.log(amplitude) - onset) / width
            loose = np.minimum(slope * width * np.logaddexp(0, x), HELD_MG)
            mean = np.maximum(loose - self.lost[:, t][:, None], 0) * -np.expm1(-((amplitude / stroke) ** bend)) + DUST_MG
            sd = np.sqrt(floor**2 + scatter**2 * mean)
            z = (np.sqrt(self.poured[:, t])[:, None] - np.sqrt(mean)) / sd
            yield t, shaken, mean, sd, np.where(shaken[:, None], -2.5 * np.log1p(z * z / 4) - np.log(sd), 0.0)

    def likelihoods(self, shared, own):
        return sum(log for *_, log in self.steps(shared, own))

    def predictions(self, shared, own):
        """Predicted mean, its SD and what fell, for each shaken step, from the steps before it."""
        found, log = [], 0.0
        for t, shaken, mean, sd, now in self.steps(shared, own):
            weight = np.exp(log - np.max(log, axis=-1, keepdims=True)) if t else np.ones_like(mean)
            weight /= weight.sum(1, keepdims=True)
            expected = (weight * mean).sum(1)
            variance = (weight * ((mean - expected[:, None]) ** 2 + 4 * mean * sd**2)).sum(1)
            found += zip(expected[shaken], np.sqrt(variance[shaken]), self.poured[shaken, t], strict=True)
            log = log + now
        return np.array(found)


def marginal(log):
    """Logarithm of the likelihood of all courses, and each course's weights of the guesses."""
    largest = log.max(1, keepdims=True)
    weight = np.exp(log - largest)
    return float((largest[:, 0] + np.log(weight.mean(1))).sum()), weight / weight.sum(1, keepdims=True)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("steps", nargs="+")
    parser.add_argument("--generations", type=int, default=100, help="of the search, each 12 likelihoods; default 100")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    courses = Courses(arguments.steps)
    few = norm.ppf(qmc.Sobol(3, rng=arguments.seed).random(512))

    def miss(x):
        own = x[:6:2] + np.abs(x[1:6:2]) * few
        return -marginal(courses.likelihoods(x[6:], own))[0]

    start = np.concatenate([OWN, SHARED])
    spread = [10, 10, 1, 0.5, 1, 0.5, 1, 2, 1, 1, 1]
    options = {"popsize": 12, "verbose": -9, "CMA_stds": spread, "seed": arguments.seed}
    search = cma.CMAEvolutionStrategy(start, 0.3, options)
    while not search.stop() and search.countiter < arguments.generations:
        asked = search.ask()
        search.tell(asked, [miss(x) for x in asked])
    best = search.result.xbest
    shared = best[6:]
    mean, covariance = best[:6:2], np.diag(best[1:6:2] ** 2)
    many = norm.ppf(qmc.Sobol(3, rng=arguments.seed + 1).random(4096))
    for _ in range(15):
        own = mean + many @ np.linalg.cholesky(covariance).T
        fit, weight = marginal(courses.likelihoods(shared, own))
        weight = weight.mean(0)
        mean = weight @ own
        covariance = (own - mean).T @ ((own - mean) * weight[:, None])
    sd = np.sqrt(np.diag(covariance))
    correlation = (covariance / np.outer(sd, sd))[np.triu_indices(3, 1)]
    print(f"{len(courses.pitch)} courses, logarithm of the likelihood {fit:.1f}")
    for name, k in (("onset_deg", 0), ("ln_slope_mg_deg", 1), ("ln_stroke_mm", 2)):
        print(f"{name}: [{mean[k]:.2f}, {sd[k]:.2f}]")
    print("correlations:", [round(float(c), 2) for c in correlation])
    bend, width, floor, scatter = np.exp(shared[[0, 2, 3, 4]])
    print(f"bend: {bend:.2f}, reach_deg: {shared[1]:.1f}, width_deg: {width:.2f}, floor: {floor:.3f}, scatter: {scatter:.3f}")
    found = courses.predictions(shared, own)
    print("predicted mg | n | mean predicted | mean fallen | SD of the difference | SD predicted")
    for low, high in ((0, 0.1), (0.1, 0.5), (0.5, 1.5), (1.5, 3), (3, 6), (6, 40)):
        of = found[(found[:, 0] > low) & (found[:, 0] <= high)]
        if len(of) > 1:
            errors, expected = np.std(of[:, 2] - of[:, 0]), np.sqrt(np.mean(of[:, 1] ** 2))
            print(f"{low}-{high} | {len(of)} | {of[:, 0].mean():.2f} | {of[:, 2].mean():.2f} | {errors:.2f} | {expected:.2f}")


if __name__ == "__main__":
    main()
