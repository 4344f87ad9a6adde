"""One Soft Actor-Critic update of recurrent networks in PyTorch: the independent implementation behind sac_recurrent_update.json.

Run it only to make that file again:  pip install torch && python3 tests/reference/sac_recurrent_update.py
Written from the equations of arXiv:1812.05905 with PyTorch's own modules, losses and optimiser, in f64, one episode after another.
It shares no code with FLIP.
"""

import json
import pathlib

import torch
from torch import nn

INPUTS, PARAMETERS, ACTIONS, HIDDEN = 3, 9, 2, 4
LENGTHS = [3, 1, 4, 2]
GAMMA, TAU, LR, TARGET_ENTROPY, ALPHA = 0.9, 0.05, 0.01, -2.0, 0.3
torch.set_default_dtype(torch.float64)


class Recurrent(nn.Module):
    def __init__(self, seen, trunk):
        super().__init__()
        self.seen, self.recalled = nn.Linear(seen, HIDDEN), nn.Linear(INPUTS + ACTIONS, HIDDEN)
        self.lstm = nn.LSTM(HIDDEN, HIDDEN)
        self.trunk = nn.ModuleList(nn.Linear(i, o) for i, o in zip(trunk, trunk[1:]))

    def remember(self, course, state=None):
        """Outputs of the LSTM along a course [steps, inputs + 2]."""
        return self.lstm(torch.relu(self.recalled(course)), state)[0]

    def forward(self, rows, remembered):
        x = torch.cat([torch.relu(self.seen(rows)), remembered], 1)
        for depth, layer in enumerate(self.trunk):
            x = layer(x)
            if depth + 1 < len(self.trunk):
                x = torch.relu(x)
        return x


def blocks(network):
    """Every parameter in the order of FLIP's flat block, and whether it is kept transposed there."""
    lstm = network.lstm
    yield from [(network.seen.weight, True), (network.seen.bias, False)]
    yield from [(network.recalled.weight, True), (network.recalled.bias, False)]
    yield from [(p, False) for p in (lstm.weight_ih_l0, lstm.weight_hh_l0, lstm.bias_ih_l0, lstm.bias_hh_l0)]
    for layer in network.trunk:
        yield from [(layer.weight, True), (layer.bias, False)]


def flat(networks, of=lambda p: p):
    pieces = [of(p).T if turned else of(p) for network in networks for p, turned in blocks(network)]
    return torch.cat([piece.reshape(-1) for piece in pieces]).detach().clone()


def squash(head, noise):
    mean, log_std = head[:, :ACTIONS], head[:, ACTIONS:].clamp(-20, 2)
    u = mean + log_std.exp() * noise
    log_prob = torch.distributions.Normal(mean, log_std.exp()).log_prob(u) - torch.log(1 - torch.tanh(u) ** 2)
    return torch.tanh(u), log_prob.sum(1)


def update(replayed):
    torch.manual_seed(20231001)
    actor = Recurrent(INPUTS, [2 * HIDDEN, HIDDEN, HIDDEN, 2 * ACTIONS])
    make_critic = lambda: Recurrent(INPUTS + PARAMETERS + ACTIONS, [2 * HIDDEN, HIDDEN, 1])
    twins, targets = [make_critic(), make_critic()], [make_critic(), make_critic()]
    with torch.no_grad():
        for network in [actor, *twins, *targets]:
            for p in network.parameters():
                p.mul_(1.5).add_(0.1 * torch.randn_like(p))
    rows = sum(LENGTHS)
    episodes = []
    for length in LENGTHS:
        episodes.append({
            "seen": torch.randn(length + 1, INPUTS), "action": torch.rand(length, ACTIONS) * 2 - 1,
            "parameters": torch.rand(PARAMETERS).expand(length, -1), "state": torch.randn(2, HIDDEN) * 0.5,
        })
    reward = 2 * torch.randn(rows)
    goes_on = (torch.rand(rows) > 0.3).double()
    noise = torch.randn(2, rows, ACTIONS)

    now = torch.cat([torch.cat([e["seen"][:-1], e["parameters"]], 1) for e in episodes])
    following = torch.cat([torch.cat([e["seen"][1:], e["parameters"]], 1) for e in episodes])
    action = torch.cat([e["action"] for e in episodes])
    for e in episodes:
        e["course"] = torch.cat([e["seen"], torch.cat([torch.zeros(1, ACTIONS), e["action"]])], 1)

    def before(network):
        return torch.cat([network.remember(e["course"][:-1]) for e in episodes])

    def after(network):
        if replayed == "episodes":
            return torch.cat([network.remember(e["course"])[1:] for e in episodes])
        state = lambda e: (e["state"][None, 0], e["state"][None, 1])
        return torch.cat([network.remember(e["course"][1:], state(e)) for e in episodes])

    given = {"actor": flat([actor]), "critics": flat(twins), "targets": flat(targets)}

    # What the critics should say.
    with torch.no_grad():
        next_action, next_log_prob = squash(actor(following[:, :INPUTS], after(actor)), noise[0])
        asked = torch.cat([following, next_action], 1)
        next_q = torch.minimum(*[q(asked, after(q))[:, 0] for q in targets])
        y = reward + GAMMA * goes_on * (next_q - ALPHA * next_log_prob)

    # Critics: the published Huber loss with stored states, half the squared error with whole episodes.
    loss = nn.SmoothL1Loss() if replayed == "stored_state" else lambda q, y: nn.functional.mse_loss(q, y) / 2
    optimiser = torch.optim.Adam([p for q in twins for p in q.parameters()], lr=LR)
    critic_loss = sum(loss(q(torch.cat([now, action], 1), before(q))[:, 0], y) for q in twins)
    critic_loss.backward()
    critic_gradient = flat(twins, lambda p: p.grad)
    optimiser.step()

    # Actor, against the new critics.
    optimiser = torch.optim.Adam(actor.parameters(), lr=LR)
    drawn, log_prob = squash(actor(now[:, :INPUTS], before(actor)), noise[1])
    q = torch.minimum(*[q(torch.cat([now, drawn], 1), before(q))[:, 0] for q in twins])
    actor_loss = (ALPHA * log_prob - q).mean()
    actor_loss.backward()
    actor_gradient = flat([actor], lambda p: p.grad)
    optimiser.step()

    log_alpha = nn.Parameter(torch.tensor(ALPHA).log())
    optimiser = torch.optim.Adam([log_alpha], lr=LR)
    (-log_alpha.exp() * (log_prob.detach() + TARGET_ENTROPY)).mean().backward()
    optimiser.step()

    steps = max(LENGTHS)
    inputs = torch.zeros(steps + 1, len(LENGTHS), INPUTS + ACTIONS)
    for k, e in enumerate(episodes):
        inputs[: LENGTHS[k] + 1, k] = e["course"]
    at = [step * len(LENGTHS) + k for k, length in enumerate(LENGTHS) for step in range(length)]
    stored = torch.cat([e["state"].reshape(-1) for e in episodes])
    return {
        "hidden": HIDDEN, "batch": len(LENGTHS), "gamma": GAMMA, "tau": TAU, "learning_rate": LR,
        "target_entropy": TARGET_ENTROPY, "alpha": ALPHA, **given,
        "now": torch.cat([now, action], 1), "next": following, "reward": reward, "goes_on": goes_on, "noise": noise,
        "courses": {
            "episodes": len(LENGTHS), "inputs": inputs, "at": at, "stored": stored if replayed == "stored_state" else None,
        },
        "expected": {
            "y": y, "critic_loss": critic_loss, "actor_loss": actor_loss, "entropy": -log_prob.mean(),
            "critic_gradient": critic_gradient, "actor_gradient": actor_gradient,
            "critics": flat(twins), "actor": flat([actor]), "log_alpha": log_alpha,
            "targets": (1 - TAU) * given["targets"] + TAU * flat(twins),
        },
    }


def plain(value):
    if isinstance(value, dict):
        return {k: plain(v) for k, v in value.items()}
    if not isinstance(value, torch.Tensor):
        return value
    return [round(x, 9) for x in value.detach().reshape(-1).tolist()] if value.dim() else value.item()


result = {replayed: plain(update(replayed)) for replayed in ("stored_state", "episodes")}
pathlib.Path(__file__).with_suffix(".json").write_text(json.dumps(result) + "\n")
