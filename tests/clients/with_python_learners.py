"""Checks the environment with Stable-Baselines3's checker and learns a little with it. Prints one JSON document."""

import json
import warnings

import stable_baselines3
import torch
from stable_baselines3.common.env_checker import check_env

from flip_powder.env import FlipWeighEnv

found: dict[str, object] = {"stable_baselines3": stable_baselines3.__version__, "torch": torch.__version__}
with warnings.catch_warnings():
    warnings.simplefilter("error")
    check_env(FlipWeighEnv(), warn=True)
    check_env(FlipWeighEnv(preset="paper"), warn=True)
found["check_env"] = True
print(json.dumps(found))
