"""Trains Stable-Baselines3's Soft Actor-Critic to weigh, and writes a policy file.

`python sb3_sac.py [STEPS] [FILE]`
"""

import sys

import gymnasium as gym
import numpy as np
from stable_baselines3 import SAC

from flip_powder.sb3 import FlipWeighVecEnv, sac_policy_file

steps = int(sys.argv[1]) if len(sys.argv) > 1 else 20_000
doses = FlipWeighVecEnv(8, preset="flip", pouring="surrogate")
learner = SAC(
    "MlpPolicy", doses, gamma=0.9, learning_starts=min(500, steps // 2), gradient_steps=8, seed=1, device="cpu"
)
learner.learn(steps)

env, errors = gym.make("FlipWeigh-v0"), []
for seed in range(200):
    seen, ended = env.reset(seed=10_000 + seed)[0], False
    while not ended:
        seen, _, terminated, truncated, info = env.step(learner.predict(seen, deterministic=True)[0])
        ended = terminated or truncated
    errors.append(abs(info["true_mg"] - info["target_mg"]))
print(f"mean absolute error of {len(errors)} doses after {steps} steps: {np.mean(errors):.2f} mg")

name, content = sac_policy_file(learner)
if len(sys.argv) > 2:
    with open(sys.argv[2], "wb") as file:
        file.write(content)
print(f"policy {name}, {len(content)} bytes")
