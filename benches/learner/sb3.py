"""Stable-Baselines3's Soft Actor-Critic, timed in turn with FLIP's.

Prints its version, then for each line `HIDDEN BATCH UPDATES OBSERVATIONS ACTIONS` on stdin the processor seconds that one update took in
that window: `SAC.train` with its defaults (batch from the replay buffer, temperature, critics, actor, targets) on one thread. A learner is
made, filled and warmed up at the first line that asks for it, outside of the clock.
"""

import sys
import time

import gymnasium
import numpy as np
import stable_baselines3
import torch
from stable_baselines3.common.logger import Logger

REMEMBERED, WARM_UP = 2000, 20


class Shape(gymnasium.Env):
    """Nothing but the sizes of observation and action; it is never stepped."""

    def __init__(self, observations, actions):
        self.observation_space = gymnasium.spaces.Box(-1.0, 1.0, (observations,), np.float32)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (actions,), np.float32)


def learner(hidden, batch, observations, actions):
    sac = stable_baselines3.SAC(
        "MlpPolicy",
        Shape(observations, actions),
        batch_size=batch,
        buffer_size=REMEMBERED,
        policy_kwargs={"net_arch": [hidden, hidden]},
        device="cpu",
        seed=1,
    )
    # Without a destination: nothing is written.
    sac.set_logger(Logger(None, []))
    rng = np.random.default_rng(1)
    for _ in range(REMEMBERED):
        seen, following = rng.uniform(-1, 1, (2, 1, observations))
        action, reward = rng.uniform(-1, 1, (1, actions)), rng.uniform(-1, 0, 1)
        sac.replay_buffer.add(seen, following, action, reward, np.array([False]), [{}])
    sac.train(WARM_UP, batch)
    return sac


torch.set_num_threads(1)
print(f"{stable_baselines3.__version__} on torch {torch.__version__}", flush=True)
learners = {}
for line in sys.stdin:
    hidden, batch, updates, observations, actions = map(int, line.split())
    if (hidden, batch) not in learners:
        learners[hidden, batch] = learner(hidden, batch, observations, actions)
    before = time.process_time()
    learners[hidden, batch].train(updates, batch)
    print((time.process_time() - before) / updates, flush=True)
