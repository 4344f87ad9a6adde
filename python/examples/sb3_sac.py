"""Trains Stable-Baselines3's Soft Actor-Critic to weigh, and writes a policy file: `python sb3_sac.py [STEPS] [FILE]`."""

import sys

import gymnasium as gym
import numpy as np
from stable_baselines3 import SAC

from flip_powder.env import policy_file

steps = int(sys.argv[1]) if len(sys.argv) > 1 else 20_000
env = gym.make("FlipWeigh-v0", preset="flip", pouring="surrogate")
learner = SAC("MlpPolicy", env, gamma=0.9, learning_starts=min(500, steps // 2), seed=1, device="cpu")
learner.learn(steps)

test, errors = gym.make("FlipWeigh-v0"), []
for seed in range(200):
    seen, ends = test.reset(seed=10_000 + seed)[0], False
    while not ends:
        seen, _, terminated, truncated, info = test.step(learner.predict(seen, deterministic=True)[0])
        ends = terminated or truncated
    errors.append(abs(info["true_mg"] - info["target_mg"]))
print(f"mean absolute error of {len(errors)} doses after {steps} steps: {np.mean(errors):.2f} mg")

actor = learner.policy.actor
hidden = [layer for layer in actor.latent_pi if hasattr(layer, "weight")]
layers = [(layer.weight.detach().numpy().T, layer.bias.detach().numpy()) for layer in hidden]
head = [(part.weight.detach().numpy().T, part.bias.detach().numpy()) for part in (actor.mu, actor.log_std)]
layers.append((np.hstack([weight for weight, _ in head]), np.hstack([bias for _, bias in head])))
name, content = policy_file(env, layers)
if len(sys.argv) > 2:
    with open(sys.argv[2], "wb") as file:
        file.write(content)
print(f"policy {name}, {len(content)} bytes")
