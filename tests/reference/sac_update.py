"""One Soft Actor-Critic update in NumPy: the independent implementation behind sac_update.json.

Run it only to make that file again:  pip install numpy && python3 tests/reference/sac_update.py
Written from the equations of arXiv:1812.05905, in f64 and with hand-derived gradients; it shares no code with FLIP.
"""

import json
import pathlib

import numpy as np

INPUTS, PARAMETERS, ACTIONS, HIDDEN, BATCH = 4, 9, 2, 6, 5
GAMMA, TAU, LR, TARGET_ENTROPY, ALPHA = 0.9, 0.05, 0.01, -2.0, 0.3
ACTOR = [INPUTS, HIDDEN, HIDDEN, 2 * ACTIONS]
CRITIC = [INPUTS + PARAMETERS + ACTIONS, HIDDEN, HIDDEN, 1]
rng = np.random.default_rng(20181205)


def network(widths):
    return [(rng.normal(0, 0.5, (i, o)), rng.normal(0, 0.3, o)) for i, o in zip(widths, widths[1:])]


def flat(layers):
    return np.concatenate([np.concatenate([w.ravel(), b]) for w, b in layers])


def forward(layers, x):
    """Output and what the backward pass needs."""
    kept = [x]
    for depth, (w, b) in enumerate(layers):
        x = x @ w + b
        if depth < len(layers) - 1:
            x = np.maximum(x, 0)
        kept.append(x)
    return x, kept


def backward(layers, kept, dy):
    """Gradients of the layers and of the input, for the gradient dy of the output."""
    grads = []
    for depth in reversed(range(len(layers))):
        w, _ = layers[depth]
        if depth < len(layers) - 1:
            dy = dy * (kept[depth + 1] > 0)
        grads.insert(0, (kept[depth].T @ dy, dy.sum(0)))
        dy = dy @ w.T
    return grads, dy


def squash(head, noise):
    mean, raw = head[:, :ACTIONS], head[:, ACTIONS:]
    log_std = np.clip(raw, -20, 2)
    u = mean + np.exp(log_std) * noise
    log_prob = -noise**2 / 2 - log_std - np.log(2 * np.pi) / 2 - np.log(1 - np.tanh(u) ** 2)
    return np.tanh(u), log_prob.sum(1), u, log_std


def adam_first_step(theta, gradient):
    m, v = 0.1 * gradient, 0.001 * gradient**2
    return theta - LR * (m / 0.1) / (np.sqrt(v / 0.001) + 1e-8)


actor, twins = network(ACTOR), [network(CRITIC), network(CRITIC)]
targets = [[(w + rng.normal(0, 0.05, w.shape), b) for w, b in q] for q in twins]
state, next_state = rng.normal(0, 1, (2, BATCH, INPUTS + PARAMETERS))
action = rng.uniform(-1, 1, (BATCH, ACTIONS))
reward, goes_on = rng.normal(0, 1, BATCH), np.array([1.0, 0.0, 1.0, 1.0, 0.0])
noise = rng.normal(0, 1, (2, BATCH, ACTIONS))

# What the critics should say.
next_action, next_log_prob, _, _ = squash(forward(actor, next_state[:, :INPUTS])[0], noise[0])
x = np.hstack([next_state, next_action])
next_q = np.minimum(*[forward(q, x)[0][:, 0] for q in targets])
y = reward + GAMMA * goes_on * (next_q - ALPHA * next_log_prob)

# Critics.
critic_loss, critic_gradient, new_twins = 0.0, [], []
for q in twins:
    out, kept = forward(q, np.hstack([state, action]))
    error = out[:, 0] - y
    critic_loss += 0.5 * np.mean(error**2)
    grads, _ = backward(q, kept, (error / BATCH)[:, None])
    critic_gradient.append(flat(grads))
    new = adam_first_step(flat(q), flat(grads))
    new_twins.append(new)


def unflat(block, widths):
    layers, at = [], 0
    for i, o in zip(widths, widths[1:]):
        layers.append((block[at : at + i * o].reshape(i, o), block[at + i * o : at + (i + 1) * o]))
        at += (i + 1) * o
    return layers


# Actor, against the new critics.
head, kept_actor = forward(actor, state[:, :INPUTS])
a, log_prob, u, log_std = squash(head, noise[1])
outs = [forward(unflat(q, CRITIC), np.hstack([state, a])) for q in new_twins]
values = np.stack([out[:, 0] for out, _ in outs])
actor_loss = np.mean(ALPHA * log_prob - values.min(0))
da = np.zeros((BATCH, ACTIONS))
for k, (_, kept) in enumerate(outs):
    chosen = (values.argmin(0) == k).astype(float)
    _, dx = backward(unflat(new_twins[k], CRITIC), kept, (-chosen / BATCH)[:, None])
    da += dx[:, -ACTIONS:]
# d log pi / du = 2 tanh(u);  du / dmean = 1;  du / dlog_std = exp(log_std) noise;  d log pi / dlog_std = -1 besides.
du = da * (1 - a**2) + ALPHA / BATCH * 2 * a
dlog_std = (du * np.exp(log_std) * noise[1] - ALPHA / BATCH) * ((head[:, ACTIONS:] > -20) & (head[:, ACTIONS:] < 2))
grads, _ = backward(actor, kept_actor, np.hstack([du, dlog_std]))

alpha_gradient = -ALPHA * (log_prob.mean() + TARGET_ENTROPY)
result = {
    "hidden": HIDDEN, "batch": BATCH, "gamma": GAMMA, "tau": TAU, "learning_rate": LR,
    "target_entropy": TARGET_ENTROPY, "alpha": ALPHA,
    "actor": flat(actor), "critics": np.concatenate([flat(q) for q in twins]),
    "targets": np.concatenate([flat(q) for q in targets]),
    "now": np.hstack([state, action]).ravel(), "next": next_state.ravel(),
    "reward": reward, "goes_on": goes_on, "noise": noise.ravel(),
    "expected": {
        "y": y, "log_prob": log_prob, "critic_loss": critic_loss, "actor_loss": actor_loss, "entropy": -log_prob.mean(),
        "critic_gradient": np.concatenate(critic_gradient), "actor_gradient": flat(grads),
        "critics": np.concatenate(new_twins), "actor": adam_first_step(flat(actor), flat(grads)),
        "log_alpha": adam_first_step(np.log(ALPHA), alpha_gradient),
        "targets": np.concatenate([(1 - TAU) * flat(q) + TAU * n for q, n in zip(targets, new_twins)]),
    },
}


def plain(value):
    if isinstance(value, dict):
        return {k: plain(v) for k, v in value.items()}
    return np.round(value, 12).tolist() if isinstance(value, np.ndarray) else float(value) if isinstance(value, np.floating) else value


pathlib.Path(__file__).with_suffix(".json").write_text(json.dumps(plain(result)) + "\n")
