"""Posterior over causes, gain on days left out, and a level of balance readings: the independent implementation behind discovery.json.

Run it only to make that file again:  pip install numpy && python3 tests/reference/discovery.py
Coefficients of features go into the covariance and predictions are universal kriging, so no whitening, no normal equations and no
projection is shared with FLIP. Every model is enumerated, and every resample of the days.
"""

import itertools
import json
import math
import pathlib

import numpy as np

rng = np.random.default_rng(20261126)


class Kriged:
    """y = x beta + f c + e,  p(beta) constant,  c ~ N(0, t^2 s^2 I),  e ~ N(0, s^2 v),  p(s) = 1 / s."""

    def __init__(self, y, x, v, f, t):
        self.y, self.x, self.f, self.t = y, x, f, t
        covariance = v + t * t * f @ f.T
        self.inverse = np.linalg.inv(covariance)
        self.normal = x.T @ self.inverse @ x
        self.beta = np.linalg.solve(self.normal, x.T @ self.inverse @ y)
        self.residual = self.inverse @ (y - x @ self.beta)
        self.left = y @ self.residual
        self.freedom = len(y) - x.shape[1]
        self.variance = self.left / self.freedom
        determinants = np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(self.normal)[1]
        # Up to a constant of y and x.
        self.log_evidence = -0.5 * determinants - 0.5 * self.freedom * math.log(self.left)

    def linear(self, at_x, at_f):
        """Mean of at_x beta + at_f c, and its variance over s^2."""
        shared = self.t**2 * self.f @ at_f
        behind = at_x - self.x.T @ self.inverse @ shared
        mean = at_x @ self.beta + shared @ self.residual
        spread = self.t**2 * at_f @ at_f - shared @ self.inverse @ shared + behind @ np.linalg.solve(self.normal, behind)
        return mean, spread


def mixture(weights, means, variances):
    """Mean and SD of a mixture."""
    weights = np.array(weights) / np.sum(weights)
    mean = weights @ means
    return [float(mean), float(math.sqrt(weights @ (np.array(variances) + (np.array(means) - mean) ** 2)))]


def log_mean(logs):
    peak = max(logs)
    return peak + math.log(np.mean(np.exp(np.array(logs) - peak)))


def posterior():
    """Sixteen runs of two powders on four days, two of them without an angle; three causes, two noises."""
    n, hidden = 16, [5, 12]
    powder, day = np.arange(n) % 2, np.arange(n) // 4
    measured = [i for i in range(n) if i not in hidden]
    weights = rng.uniform(0.7, 1.3, n)
    amplitudes, models = [0.15, 0.3, 0.6, 1.2], [0.5, 0.35, 0.15]
    noises = [(0.0, 0.0), (0.6, 0.05)]
    causes = [
        {"prior": 1.0, "features": [rng.normal(size=(n, 2)), rng.normal(size=(n, 2))]},
        {"prior": 0.3, "features": [rng.normal(size=(n, 1))]},
        {"prior": 0.05, "features": [rng.normal(size=(n, 1))]},
    ]
    x = (powder[:, None] == np.arange(2)).astype(float)
    y = 0.5 * causes[0]["features"][0][:, 0] + 0.5 * causes[1]["features"][0][:, 0] + weights * rng.normal(size=n)
    same_day = (day[:, None] == day[None, :]).astype(float)
    same_both = same_day * (powder[:, None] == powder[None, :])

    components = []

    def judge(parts, log_prior, sizes):
        f = np.hstack([causes[h]["features"][k] for h, k in parts] or [np.zeros((n, 0))])
        for day_ratio, both_ratio in noises:
            v = np.diag(weights**2) + day_ratio * same_day + both_ratio * same_both
            for t in sizes:
                fitted = Kriged(y[measured], x[measured], v[np.ix_(measured, measured)], f[measured], t)
                components.append((fitted.log_evidence + log_prior, parts, f, day_ratio + both_ratio, fitted))

    judge([], math.log(models[0] / len(noises)), [1.0])
    total = sum(one["prior"] for one in causes)
    for h, one in enumerate(causes):
        count = len(one["features"]) * len(noises) * len(amplitudes)
        for k in range(len(one["features"])):
            judge([(h, k)], math.log(models[1] * one["prior"] / total / count), amplitudes)
    pairs = list(itertools.combinations(range(len(causes)), 2))
    total = sum(causes[a]["prior"] * causes[b]["prior"] for a, b in pairs)
    for a, b in pairs:
        count = len(causes[a]["features"]) * len(causes[b]["features"]) * len(noises) * len(amplitudes)
        log_prior = math.log(models[2] * causes[a]["prior"] * causes[b]["prior"] / total / count)
        for k, l in itertools.product(range(len(causes[a]["features"])), range(len(causes[b]["features"]))):
            judge([(a, k), (b, l)], log_prior, amplitudes)

    peak = max(one[0] for one in components)
    weight = [math.exp(one[0] - peak) for one in components]
    some = sum(w for w, one in zip(weight, components) if one[1])
    inclusion = [sum(w for w, one in zip(weight, components) if h in [part[0] for part in one[1]]) / some for h in range(len(causes))]

    def heavy(which):
        """Components of predictions: those above a thousandth of the heaviest."""
        chosen = [(w, one) for w, one in zip(weight, components) if which(one)]
        heaviest = max(w for w, _ in chosen)
        return [(w, one) for w, one in chosen if w > 1e-3 * heaviest]

    def predicted(which, row):
        weights_, means, variances = [], [], []
        for w, (_, _, f, shared, fitted) in heavy(which):
            mean, spread = fitted.linear(x[row], f[row])
            spread += weights[row] ** 2 + shared
            weights_.append(w), means.append(mean), variances.append(fitted.variance * spread * fitted.freedom / (fitted.freedom - 2))
        return mixture(weights_, means, variances)

    def effect(h, low, high):
        weights_, means, variances = [], [], []
        for w, (_, parts, f, _, fitted) in heavy(lambda one: h in [part[0] for part in one[1]]):
            owner = np.concatenate([np.full(causes[part[0]]["features"][part[1]].shape[1], part[0]) for part in parts])
            mean, spread = fitted.linear(np.zeros(2), np.where(owner == h, f[high] - f[low], 0.0))
            weights_.append(w), means.append(mean), variances.append(fitted.variance * spread * fitted.freedom / (fitted.freedom - 2))
        return mixture(weights_, means, variances)

    return {
        "powder": powder.tolist(), "session": day.tolist(), "measured": measured, "weights": weights.tolist(),
        "noises": noises, "observed": y[measured].tolist(),
        "causes": [{"prior": one["prior"], "features": [f.tolist() for f in one["features"]]} for one in causes],
        "inclusion": inclusion,
        "before": [predicted(lambda one: not one[1], row) for row in range(n)],
        "after": [predicted(lambda one: True, row) for row in range(n)],
        "effect": {"cause": 0, "low": 3, "high": 12, "mean_sd": effect(0, 3, 12)},
    }


def held_out(case, shift, narrower):
    """Runs on four days; intervals are those of all 256 resamples of the days."""
    resamples = np.array(list(itertools.product(range(4), repeat=4)))
    while True:
        session = np.repeat(np.arange(4), [6, 5, 7, 6])
        before = rng.normal(0, 2, len(session)) + rng.normal(0, 1, 4)[session]
        after = before * 0.6 + shift * rng.normal(0, 1, len(session))
        sds = np.column_stack([np.full(len(session), 2.2), np.full(len(session), 2.2 * narrower)])
        errors = np.column_stack([before, after])
        scores = -0.5 * (errors / sds) ** 2 - np.log(sds) - 0.5 * math.log(2 * math.pi)

        def rmse(rows, k):
            return math.sqrt(np.mean(errors[rows, k] ** 2))

        def interval(values):
            """Each end of the 95 % interval over all resamples, as the range in which 2000 draws have it."""
            values = np.sort(values)
            at = lambda share: float(values[int(share * len(values))])
            return [[at(share - 0.01), at(share + 0.01)] for share in (0.025, 0.975)]

        rows = np.arange(len(session))
        of_day = session[None, :] == np.arange(4)[:, None]
        count = of_day.sum(axis=1)[resamples].sum(axis=1)
        mean_of = lambda values: (of_day @ values)[resamples].sum(axis=1) / count
        of_rmse = interval(np.sqrt(mean_of(errors[:, 0] ** 2)) - np.sqrt(mean_of(errors[:, 1] ** 2)))
        of_score = interval(mean_of(scores[:, 1]) - mean_of(scores[:, 0]))
        is_smaller, is_better = rmse(rows, 1) < rmse(rows, 0), of_score[0][0] > 0
        if case == (bool(is_smaller), bool(is_better)) and (is_better or of_score[0][1] < 0):
            break
    coverage = np.mean(np.abs(errors) <= 1.645 * sds, axis=0)
    return {
        "session": session.tolist(), "errors": errors.tolist(), "sds": sds.tolist(),
        "rmse": [rmse(rows, 0), rmse(rows, 1)], "rmse_ci95": of_rmse,
        "log_score": np.mean(scores, axis=0).tolist(), "log_score_ci95": of_score,
        "coverage90": coverage.tolist(), "accepted": bool(is_smaller and is_better),
    }


def level(wander):
    """Twelve rows in three weighings, two plain noises and two that wander, one cause with two forms that differs between two groups."""
    n, sizes = 12, [0.02, 0.06, 0.2, 0.6, 2.0, 6.0]
    block = np.repeat(np.arange(3), 4)
    group = np.array([0, 0, 1])[block]
    apart = np.abs(np.arange(n)[:, None] - np.arange(n)[None, :])
    same = (block[:, None] == block[None, :]).astype(float)
    noises = [(0.0, 1.0, False), (0.4, 0.5, False), (1.0, 2.0, True), (10.0, 4.0, True)]
    x = (block[:, None] == np.arange(3)).astype(float)
    courses = [np.sin(0.9 * np.arange(n)), (np.arange(n) % 4) ** 1.5]
    scales, differ, white = [1.7, 0.6], [0.3, 1.0], 0.02
    y = 0.5 * courses[1] + 2.0 * block + 0.1 * rng.normal(size=n) + wander * np.cumsum(rng.normal(size=n))
    logs, parts, null = {}, [], {}
    for j, (ratio, length, is_wander) in enumerate(noises):
        v = np.eye(n) + ratio * same * np.exp(-apart / length)
        none = Kriged(y, x, v, np.zeros((n, 1)), 1.0)
        null[j] = none.log_evidence
        logs[j] = []
        for course, scale in zip(courses, scales):
            for share in differ:
                f = np.column_stack([course, share * course * (group == 0), share * course * (group == 1)])
                for t in sizes:
                    fitted = Kriged(y, x, v, f, t)
                    mean, spread = fitted.linear(np.zeros(3), np.array([1.0, 0.0, 0.0]))
                    # A common part and as much of it in every group are one course: the prior that only divides them is no part of the size.
                    unseen = np.linalg.svd(f)[2][2]
                    spread -= t * t * unseen[0] ** 2
                    logs[j].append(fitted.log_evidence)
                    parts.append((fitted.log_evidence, scale * mean, scale**2 * fitted.variance * spread, j, none.left, fitted.left, fitted.freedom))
    plain, wandering = [j for j in null if not noises[j][2]], [j for j in null if noises[j][2]]
    of_noise = lambda which: log_mean([log_mean(logs[j]) for j in which])
    of_null = lambda which: log_mean([null[j] for j in which])
    alone, other = of_noise(plain), of_noise(wandering)
    both = log_mean([alone, other])
    # Plain and wandering noises are as many, so all parts have one prior.
    weight = np.exp(np.array([part[0] for part in parts]) - max(part[0] for part in parts))
    mean, sd = mixture(weight, [part[1] for part in parts], [part[2] for part in parts])
    best = max((part for part in parts if part[3] in plain), key=lambda part: part[0])
    gained = min(1.0, max(0.0, (alone - of_null(plain)) / (both - of_null(plain))))
    beyond = best[4] - white * best[6]
    squares = min(1.0, (best[4] - best[5]) / beyond) if beyond > 0 else 0.0
    only = math.exp(alone) / (math.exp(alone) + math.exp(other))
    return {
        "noises": noises, "group": group.tolist(), "observed": y.tolist(), "courses": [c.tolist() for c in courses], "scales": scales,
        "differ": differ, "white": white, "log_cause": float(both - of_null(plain)), "log_wander": float(of_null(wandering) - of_null(plain)),
        "size": [mean, mean - 1.96 * sd, mean + 1.96 * sd], "gained_only": only + (1 - only) * gained, "explained": only + (1 - only) * max(gained, squares),
        "left": float(best[5] / best[4]),
    }


def drawn_until(draw, is_wanted):
    """Another draw until it says something."""
    while not is_wanted(one := draw()):
        pass
    return one


cases = {
    "posterior": posterior(),
    "held_out": [held_out((True, True), 0.3, 0.7), held_out((True, False), 0.8, 0.9), held_out((False, False), 2.5, 0.9)],
    "level": drawn_until(lambda: level(0.6), lambda one: 0.2 < one["gained_only"] < 0.7 and 0.05 < one["explained"] - one["gained_only"] and one["explained"] < 0.95),
}
path = pathlib.Path(__file__).with_suffix(".json")
path.write_text("{\n" + ",\n".join(f'"{name}": {json.dumps(one)}' for name, one in cases.items()) + "\n}\n")
print({"inclusion": cases["posterior"]["inclusion"], "effect": cases["posterior"]["effect"], "accepted": [one["accepted"] for one in cases["held_out"]]})
print({key: cases["level"][key] for key in ("log_cause", "log_wander", "size", "gained_only", "explained", "left")})
for one in cases["held_out"]:
    print(one["rmse"], one["rmse_ci95"], one["log_score"], one["log_score_ci95"], one["coverage90"])
