"""Checks the environment with Stable-Baselines3's checker, and writes what an untrained actor of its would do.

`with_python_learners.py FILE` writes a policy file. Prints one JSON document.
"""

import json
import sys
import warnings

import numpy as np
import stable_baselines3
import torch
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor

from flip_powder.env import FlipWeighEnv
from flip_powder.sb3 import FlipWeighVecEnv, sac_policy_file

found: dict[str, object] = {"stable_baselines3": stable_baselines3.__version__, "torch": torch.__version__}
with warnings.catch_warnings():
    warnings.simplefilter("error")
    check_env(FlipWeighEnv(), warn=True)
    check_env(FlipWeighEnv(preset="paper"), warn=True)
found["check_env"] = True

# Doses in lockstep are what Stable-Baselines3 makes of single ones.
ours, theirs = FlipWeighVecEnv(3), DummyVecEnv([FlipWeighEnv] * 3)
for env in (ours, theirs):
    env.seed(5)
same, ends = [np.array_equal(ours.reset(), theirs.reset())], 0
rng = np.random.default_rng(1)
for _ in range(60):
    actions = rng.uniform(-0.3, 1, (3, 2)).astype(np.float32)
    a, b = ours.step(actions), theirs.step(actions)
    same += [np.array_equal(x, y) for x, y in zip(a[:3], b[:3], strict=True)]
    for k in np.flatnonzero(a[2]):
        ends += 1
        same += [np.array_equal(a[3][k][it], b[3][k][it]) for it in ("terminal_observation", "TimeLimit.truncated", "true_mg")]
found["vec_env"] = [all(same), ends > 10]
PPO("MlpPolicy", VecMonitor(FlipWeighVecEnv(16)), n_steps=8, batch_size=32, device="cpu", seed=1).learn(256)

learner = SAC("MlpPolicy", FlipWeighVecEnv(2), seed=3, device="cpu", policy_kwargs={"net_arch": [32, 32]})
env = FlipWeighEnv(readability_mg=0.1)
seen, info = env.reset(seed=4)
action, _ = learner.predict(seen, deterministic=True)
found["asked"] = [info["reading_mg"], info["target_mg"], info["pitch_deg"]]
found["action"] = [float(action[0]) * 8.0, (float(action[1]) + 1.0) / 2.0 * 16.0]
found["policy"], content = sac_policy_file(learner)
with open(sys.argv[1], "wb") as file:
    file.write(content)
print(json.dumps(found))
