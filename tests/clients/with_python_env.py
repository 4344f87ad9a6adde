"""Plays flip_powder.env with Gymnasium's own checkers. Prints one JSON document."""

import json
import pickle
import warnings

import gymnasium as gym
import numpy as np
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

from flip_powder.env import FlipWeighEnv, Level
from flip_powder.sim import ParameterSet

found: dict[str, object] = {"gymnasium": gym.__version__}
with warnings.catch_warnings():
    warnings.simplefilter("error")
    for options in ({}, {"preset": "paper"}, {"encoding": "fall_and_repose"}, {"pouring": "simulator", "particles": 600}):
        check_env(FlipWeighEnv(**options), skip_render_check=True)
found["check_env"] = True

# The vector environment plays what single ones play.
singles = [gym.make("FlipWeigh-v0", preset="flip", readability_mg=0.1) for _ in range(5)]
several = gym.make_vec("FlipWeigh-v0", num_envs=5, preset="flip", readability_mg=0.1)
found["vector"] = type(several.unwrapped).__name__
actions = np.random.default_rng(1).uniform(-0.2, 1, (40, 5, 2)).astype(np.float32)
seen, _ = several.reset(seed=7)
alone = [env.reset(seed=7 + k)[0] for k, env in enumerate(singles)]
same, ended, ends = [np.array_equal(seen, alone)], [False] * 5, 0
for step in actions:
    seen, rewards, terminated, truncated, infos = several.step(step)
    for k, env in enumerate(singles):
        if ended[k]:
            one, info = env.reset()
            reward, ended[k] = 0.0, False
            same.append(not terminated[k] and not truncated[k])
        else:
            one, reward, stops, cut, info = env.step(step[k])
            ended[k] = stops or cut
            same.append((stops, cut) == (terminated[k], truncated[k]))
            ends += ended[k]
        same += [np.array_equal(one, seen[k]), reward == rewards[k], info["true_mg"] == infos["true_mg"][k]]
        same.append(bool(infos["_true_mg"][k]))
found["lockstep"] = [all(same), ends > 5]

# Autoreset as Gymnasium's own vector environments do it.
for mode in (AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP):
    ours = gym.make_vec("FlipWeigh-v0", num_envs=3, preset="paper", autoreset_mode=mode)
    theirs = gym.vector.SyncVectorEnv([lambda: FlipWeighEnv(preset="paper")] * 3, autoreset_mode=mode)
    same = [np.array_equal(ours.reset(seed=3)[0], theirs.reset(seed=3)[0]), ours.metadata["autoreset_mode"] is mode]
    for step in actions[:25]:
        a, b = ours.step(step[:3]), theirs.step(step[:3])
        same += [np.array_equal(x, y) for x, y in zip(a[:4], b[:4], strict=True)]
        same.append(("final_obs" in a[4]) == ("final_obs" in b[4]))
        if "final_obs" in b[4]:
            same.append(np.array_equal(np.stack(a[4]["final_obs"]), np.stack(b[4]["final_obs"])))
            same.append(np.array_equal(a[4]["final_info"]["true_mg"], b[4]["final_info"]["true_mg"]))
    found[mode.value] = all(same)
manual = gym.make_vec("FlipWeigh-v0", num_envs=3, preset="paper", autoreset_mode="Disabled")
manual.reset(seed=1)
for step in actions[:10]:
    *_, truncated, infos = manual.step(step[:3])
mask = np.array([True, False, True])
_, infos = manual.reset(options={"reset_mask": mask})
found["Disabled"] = [bool(truncated.all()), infos["step"].tolist(), infos["_step"].tolist()]
try:
    manual.step(actions[0, :3])
except ValueError as error:
    found["ended"] = "reset" in str(error)

# Levels, targets, what a critic may know, what is refused.
levels = [Level("steep", 38.0, [ParameterSet(friction=0.9)]), Level("flat", 28.0, [ParameterSet(friction=0.2)])]
env = gym.make("FlipWeigh-v0", levels=levels, level=1, box_share=0.0, extensions={"humidity": 0.3}, pouring="simulator", particles=600)
_, info = env.reset(seed=1, options={"target_mg": 4.0})
found["level"] = [info["level"], info["target_mg"], round(float(env.unwrapped.parameters[4]) * 1.3, 3)]
found["settings"] = [env.unwrapped.settings["spoon"]["extensions"]["humidity"], env.unwrapped.settings["order"]]
refused = []
for wrong in ({"readability_mg": -1.0}, {"preset": "mine"}, {"settings": {"colour": 1}}, {"extensions": {"magic": 1.0}}, {"order": "random"}, {"levels": [Level("x", 30.0, [])]}):
    try:
        FlipWeighEnv(**wrong)
    except ValueError as error:
        refused.append(str(error).split(":")[0])
found["refused"] = refused
found["pickled_spec"] = gym.make(pickle.loads(pickle.dumps(gym.make("FlipWeigh-v0", preset="paper").spec))).unwrapped.settings["preset"]
print(json.dumps(found))
