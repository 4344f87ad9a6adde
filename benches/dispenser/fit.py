"""The prior of the dispenser from steps of simulated spoons. usage: fit.py STEPS.csv [STEPS.csv ...] [--by-directions] [--generations N]

STEPS.csv is what `cargo experiment shake_response` prints. The model is that of crates/flip-policy/src/dispenser.rs:

    G = slope width softplus((p + reach ln A - onset) / width), at most held
    mean of a shake = max(G - M, 0) (1 - exp(-(A / stroke)^bend))
    sqrt(mass) ~ t_4(sqrt(mean), floor^2 + scatter^2 mean)

with M what the spoon has lost before (vial and spilled). Onset, ln slope and ln stroke are each course's own, jointly normal over the courses.
CMA-ES looks for the numbers that all courses share, then expectation maximisation for the mean and covariance of those three. With --by-
directions their mean is linear in the five numbers that a powder's set folds into, and the shared numbers are searched once more: the model
of crates/flip-learn/src/train/surrogate.rs. Prints the numbers as crates/flip-policy/src/response.rs and that file have them, and how predictions compare with what fell,
each made before the step from the course's earlier steps. Last come the first pieces that the spoons let go of, by the amplitude that freed
them; with --generations 0 nothing is fitted and they come alone.

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
    """Pitch, amplitude (0 for none), mass in the vial and spilled, each of shape (courses, steps), and the directions (courses, 5)."""
    courses, directions = {}, {}
    for path in paths:
        with open(path, newline="") as file:
            for row in csv.DictReader(file):
                numbers = [float(row[key]) for key in ("pitch_deg", "shake_mm", "poured_mg", "spilled_mg")]
                course = path, row["course"]
                courses.setdefault(course, []).append(numbers)
                directions[course] = [float(row.get(f"d{k}") or 0) for k in range(1, 6)]
    pitch, shake, poured, spilled = np.moveaxis(np.array(list(courses.values())), 2, 0)
    return pitch, np.where(shake < 0.9, 0.0, shake), poured, spilled, np.array(list(directions.values()))


class Courses:
    def __init__(self, paths):
        self.pitch, self.shake, self.poured, spilled, self.directions = read(paths)
        lost = self.poured + spilled
        self.lost = np.cumsum(lost, 1) - lost

    def steps(self, shared, own):
        """For each step its shaken courses, the means under each guess and the logarithms of the likelihoods."""
        bend, width, floor, scatter = np.exp(shared[[0, 2, 3, 4]])
        onset, slope, stroke = own[..., 0], np.exp(own[..., 1]), np.exp(own[..., 2])
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
        """Logarithm of the likelihood of each course (first) under each guess; `own` is (guesses, 3) or (courses, guesses, 3)."""
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


def tell_first_pieces(courses):
    """Of each course the first mass of more than 0.3 mg."""
    shaken, first = courses.shake > 0, (courses.poured > 0.3).argmax(1)
    at = np.arange(len(first)), first
    fell, amplitude = courses.poured[at], np.where(shaken, courses.shake, 0.0)[at]
    print("amplitude mm | first pieces above 0.3 mg | median mg | share above 5 mg")
    for low, high in ((0.9, 2), (2, 4), (4, 8), (8, 16.1)):
        of = fell[(fell > 0.3) & (amplitude >= low) & (amplitude < high)]
        if len(of):
            print(f"{low:g}-{high:g} | {len(of)} | {np.median(of):.1f} | {np.mean(of > 5):.2f}")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("steps", nargs="+")
    parser.add_argument("--generations", type=int, default=100, help="of the search, each 12 likelihoods; default 100")
    parser.add_argument("--by-directions", action="store_true", help="of courses of many powders: the surrogate spoon of trainings")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    courses = Courses(arguments.steps)
    if arguments.generations == 0:
        tell_first_pieces(courses)
        return
    few = norm.ppf(qmc.Sobol(3, rng=arguments.seed).random(512))

    def miss(x):
        own = x[:6:2] + np.abs(x[1:6:2]) * few
        return -marginal(courses.likelihoods(x[6:], own))[0]

    def search(function, start, spread, generations):
        options = {"popsize": 12, "verbose": -9, "CMA_stds": spread, "seed": arguments.seed}
        search = cma.CMAEvolutionStrategy(start, 0.3, options)
        while not search.stop() and search.countiter < generations:
            asked = search.ask()
            search.tell(asked, [function(x) for x in asked])
        return search.result.xbest

    of_shared = [1, 2, 1, 1, 1]
    best = search(miss, np.concatenate([OWN, SHARED]), [10, 10, 1, 0.5, 1, 0.5, *of_shared], arguments.generations)
    shared = best[6:]
    columns = [np.ones(len(courses.pitch)), *courses.directions.T] if arguments.by_directions else [np.ones(len(courses.pitch))]
    design = np.stack(columns, 1)
    rows = np.zeros((3, design.shape[1]))
    rows[:, 0] = best[:6:2]
    covariance = np.diag(best[1:6:2] ** 2)

    def guesses(z):
        """Guesses of each course, (courses, guesses, 3); without directions all courses have the same, (guesses, 3)."""
        spread = z @ np.linalg.cholesky(covariance).T
        return (design @ rows.T)[:, None] + spread if arguments.by_directions else rows[:, 0] + spread

    def maximise(z, rounds):
        nonlocal rows, covariance
        for _ in range(rounds):
            own = guesses(z)
            fit, weight = marginal(courses.likelihoods(shared, own))
            own = np.broadcast_to(own, (*weight.shape, 3))
            middle = (weight[..., None] * own).sum(1)
            rows = np.linalg.lstsq(design, middle, rcond=None)[0].T
            away = own - (design @ rows.T)[:, None]
            covariance = np.einsum("cg,cgi,cgj->ij", weight, away, away) / len(weight)
        return fit

    many = norm.ppf(qmc.Sobol(3, rng=arguments.seed + 1).random(1024 if arguments.by_directions else 4096))
    fit = maximise(many, 15)
    if arguments.by_directions:
        for _ in range(2):
            few_each = guesses(few)
            shared = search(lambda x: -marginal(courses.likelihoods(x, few_each))[0], shared, of_shared, arguments.generations // 2)
            fit = maximise(many, 15)
    own = guesses(many)
    mean, sd = rows[:, 0], np.sqrt(np.diag(covariance))
    correlation = (covariance / np.outer(sd, sd))[np.triu_indices(3, 1)]
    print(f"{len(courses.pitch)} courses, logarithm of the likelihood {fit:.1f}")
    for k, name in enumerate(("onset_deg", "ln_slope_mg_deg", "ln_stroke_mm")):
        print(f"{name}: [{mean[k]:.2f}, {sd[k]:.2f}]", *[f"by directions {[round(float(b), 3) for b in rows[k]]}"] * arguments.by_directions)
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
    tell_first_pieces(courses)


if __name__ == "__main__":
    main()
