"""Evidence of mixed linear models by quadrature: the independent implementation behind mixed_model.json.

Run it only to make that file again:  pip install numpy && python3 tests/reference/mixed_model.py
The coefficients of the features go into the covariance, or, with a sign, the first of them is integrated numerically over half a line;
the scale s numerically over log s. It shares no code and no algebra of whitening with FLIP.
"""

import json
import pathlib

import numpy as np

rng = np.random.default_rng(20261123)


def reduced(y, x, covariance):
    """Squares that are left of y, determinants and freedom, once beta is integrated out of N(y; x beta, covariance)."""
    inverse = np.linalg.inv(covariance)
    normal = x.T @ inverse @ x
    left = y @ inverse @ y - (x.T @ inverse @ y) @ np.linalg.solve(normal, x.T @ inverse @ y)
    determinants = np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(normal)[1]
    return left, determinants, len(y) - x.shape[1]


def log_density_given_scale(left, determinants, freedom, log_s):
    """log of the integral over beta of N(y; x beta, s^2 covariance)."""
    return -0.5 * (freedom * np.log(2 * np.pi) + determinants + left * np.exp(-2 * log_s)) - freedom * log_s


class Parts:
    """The squares left of y - c g as a polynomial in c, from three values of c."""

    def __init__(self, y, g, x, covariance):
        left = [reduced(y - c * g, x, covariance) for c in (-1.0, 0.0, 1.0)]
        self.determinants, self.freedom = left[1][1:]
        self.constant = left[1][0]
        self.linear = (left[2][0] - left[0][0]) / 2
        self.square = (left[2][0] + left[0][0]) / 2 - left[1][0]

    def log_density(self, c, log_s):
        left = self.constant + self.linear * c + self.square * c * c
        return log_density_given_scale(left, self.determinants, self.freedom, log_s)


def log_integral(log_values, step):
    """log of the integral of exp over an even grid: the trapezoidal rule is exact to rounding for smooth functions that vanish at both ends."""
    peak = log_values.max()
    return peak + np.log(np.exp(log_values - peak).sum() * step)


def evidence(y, x, v, f, t, sign):
    log_s, step = np.linspace(np.log(y.std()) - 8, np.log(y.std()) + 8, 4001, retstep=True)
    if sign == 0:
        # p(s) = 1 / s is constant in log s.
        return log_integral(log_density_given_scale(*reduced(y, x, v + t * t * f @ f.T), log_s), step)
    parts = Parts(y, f[:, 0], x, v + t * t * f[:, 1:] @ f[:, 1:].T)
    # The first coefficient over s is sign * u with u > 0, twice the normal density; integrated over log u.
    log_u, step_u = np.linspace(np.log(t) - 40, np.log(t) + 4, 4001, retstep=True)
    u = np.exp(log_u)
    prior = np.log(2) - 0.5 * np.log(2 * np.pi) - np.log(t) - 0.5 * (u / t) ** 2 + log_u
    log_s, step = log_s[::10], step * 10
    inner = np.array([log_integral(parts.log_density(sign * u * np.exp(at), at) + prior, step_u) for at in log_s])
    return log_integral(inner, step)


def case(n, k, sign):
    powder = np.sort(rng.integers(0, 3, n))
    powder[:3] = [0, 1, 2]
    day = rng.integers(0, 4, n)
    x = (powder[:, None] == np.arange(3)).astype(float)
    weights = rng.uniform(0.6, 1.5, n)
    ratios = [float(r) for r in rng.choice([0.0, 0.2, 1.0], 2)]
    same_day = (day[:, None] == day[None, :]).astype(float)
    same_both = same_day * (powder[:, None] == powder[None, :])
    v = np.diag(weights**2) + ratios[0] * same_day + ratios[1] * same_both
    f = rng.normal(size=(n, k))
    t = float(rng.choice([0.15, 0.6, 2.0]))
    y = 3 * powder + f @ rng.normal(0, 0.7, k) + weights * rng.normal(size=n)
    return {
        "powder": powder.tolist(),
        "day": day.tolist(),
        "weights": weights.tolist(),
        "ratios": ratios,
        "features": f.tolist(),
        "amplitude": t,
        "sign": sign,
        "observations": y.tolist(),
        "log_null": float(evidence(y, x, v, np.zeros((n, 1)), 1.0, 0)),
        "log_evidence": float(evidence(y, x, v, f, t, sign)),
    }


cases = [case(n, k, sign) for n, k in [(8, 1), (12, 2), (15, 3), (20, 4), (30, 6), (40, 2), (60, 6)] for sign in (0, 1, -1)]
path = pathlib.Path(__file__).with_suffix(".json")
path.write_text("[\n" + ",\n".join(json.dumps(one) for one in cases) + "\n]\n")
print(f"{len(cases)} cases in {path}")
