"""Proximal policy optimisation in one file, in the manner of CleanRL, on doses in lockstep: `python ppo.py [STEPS]`.

After CleanRL's `ppo_continuous_action.py` (MIT), cut down to what this task needs.
"""

import sys
import time

import gymnasium as gym
import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from torch import nn
from torch.distributions import Normal

import flip_powder.env  # noqa: F401

STEPS = int(sys.argv[1]) if len(sys.argv) > 1 else 400_000
DOSES, ROLLOUT, EPOCHS, BATCH = 256, 20, 4, 1024
GAMMA, LAMBDA, CLIP, ENTROPY, RATE = 0.9, 0.95, 0.2, 0.001, 1e-3

torch.manual_seed(1)
rng = np.random.default_rng(1)
# With the next episode's first observation in the step that ends one, every step is a transition.
envs = gym.make_vec("FlipWeigh-v0", num_envs=DOSES, autoreset_mode=AutoresetMode.SAME_STEP)
inputs = envs.single_observation_space.sample().size


def network(outputs: int, scale: float) -> nn.Sequential:
    """Two hidden layers."""
    last = nn.Linear(64, outputs)
    nn.init.orthogonal_(last.weight, scale)
    nn.init.zeros_(last.bias)
    return nn.Sequential(nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), last)


actor, critic, log_std = network(2, 0.01), network(1, 1.0), nn.Parameter(torch.zeros(2))
optimiser = torch.optim.Adam([*actor.parameters(), *critic.parameters(), log_std], lr=RATE)

seen = torch.as_tensor(envs.reset(seed=1)[0])
errors: list[float] = []
began = time.monotonic()
updates = max(STEPS // (DOSES * ROLLOUT), 1)
for _update in range(updates):
    seens, actions, logs, rewards, nexts, dones = [], [], [], [], [], []
    for _ in range(ROLLOUT):
        with torch.no_grad():
            policy = Normal(actor(seen), log_std.exp())
            action = policy.sample()
        following, reward, terminated, truncated, infos = envs.step(action.clamp(-1, 1).numpy())
        following = torch.as_tensor(following)
        last = following.clone()
        if "final_obs" in infos:
            ended = infos["_final_obs"]
            last[ended] = torch.as_tensor(np.stack(infos["final_obs"][ended]))
            final = infos["final_info"]
            errors.extend(np.abs(final["true_mg"] - final["target_mg"])[ended])
        seens.append(seen)
        actions.append(action)
        logs.append(policy.log_prob(action).sum(1))
        rewards.append(torch.as_tensor(reward, dtype=torch.float32))
        nexts.append(last)
        dones.append(torch.as_tensor(np.stack([terminated, terminated | truncated]), dtype=torch.float32))
        seen = following
    with torch.no_grad():
        values, following_values = (critic(torch.stack(it)).squeeze(-1) for it in (seens, nexts))
        advantages, advantage = [], torch.zeros(DOSES)
        for k in reversed(range(ROLLOUT)):
            terminated, ended = dones[k]
            delta = rewards[k] + GAMMA * following_values[k] * (1 - terminated) - values[k]
            advantage = delta + GAMMA * LAMBDA * (1 - ended) * advantage
            advantages.append(advantage)
        advantage = torch.stack(advantages[::-1])
        target = (advantage + values).reshape(-1)
    flat_seen, flat_action, flat_log = torch.cat(seens), torch.cat(actions), torch.cat(logs)
    advantage = ((advantage - advantage.mean()) / (advantage.std() + 1e-8)).reshape(-1)
    for _ in range(EPOCHS):
        for part in torch.as_tensor(rng.permutation(len(target))).split(BATCH):
            policy = Normal(actor(flat_seen[part]), log_std.exp())
            ratio = (policy.log_prob(flat_action[part]).sum(1) - flat_log[part]).exp()
            gain = torch.min(ratio * advantage[part], ratio.clamp(1 - CLIP, 1 + CLIP) * advantage[part])
            value_loss = (critic(flat_seen[part]).squeeze(-1) - target[part]).square().mean()
            loss = -gain.mean() + 0.5 * value_loss - ENTROPY * policy.entropy().sum(1).mean()
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_([*actor.parameters(), *critic.parameters(), log_std], 0.5)
            optimiser.step()

steps = updates * DOSES * ROLLOUT
recent = errors[-2000:]
seconds = time.monotonic() - began
print(
    f"{steps} steps in {seconds:.0f} s, mean absolute error of the last {len(recent)} doses: {np.mean(recent):.2f} mg"
)
