"""Stable-Baselines3: doses in lockstep as its `VecEnv`, and its Soft Actor-Critic as a policy file of FLIP.

>>> from stable_baselines3 import SAC
>>> from flip_powder.sb3 import FlipWeighVecEnv, sac_policy_file
>>> learner = SAC("MlpPolicy", FlipWeighVecEnv(64, preset="flip"), gamma=0.9)
>>> learner.learn(50_000)
>>> name, content = sac_policy_file(learner)
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.vec_env.base_vec_env import VecEnv

from .env import FlipWeighVectorEnv, policy_file

__all__ = ["FlipWeighVecEnv", "sac_policy_file"]

Indices = None | int | Iterable[int]


class FlipWeighVecEnv(VecEnv):
    """:class:`~flip_powder.env.FlipWeighVectorEnv` in the form of Stable-Baselines3.

    Args:
        num_envs: how many doses.
        **options: as of :class:`~flip_powder.env.FlipWeighEnv`.
    """

    def __init__(self, num_envs: int, **options: Any) -> None:
        self.doses = FlipWeighVectorEnv(num_envs, autoreset_mode=AutoresetMode.SAME_STEP, **options)
        super().__init__(num_envs, self.doses.single_observation_space, self.doses.single_action_space)
        self._actions: NDArray[np.float32] | None = None

    @property
    def unwrapped(self) -> FlipWeighVectorEnv:
        """Gymnasium's form of it."""
        return self.doses

    def reset(self) -> NDArray[np.float32]:
        """Begins new doses."""
        options = self._options[0] or None
        seeds = None if all(seed is None for seed in self._seeds) else self._seeds
        observations, infos = self.doses.reset(seed=seeds, options=options)
        self.reset_infos = [_one(infos, k) for k in range(self.num_envs)]
        self._reset_seeds()
        self._reset_options()
        return observations

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Takes the actions of the next step."""
        self._actions = actions

    def step_wait(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Carries them out. Only a dose that ended has an `info`: with the facts of its last step."""
        if self._actions is None:
            raise RuntimeError("step_async comes first")
        observations, rewards, terminated, truncated, infos = self.doses.step(self._actions)
        ended = terminated | truncated
        told: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for k in np.flatnonzero(ended):
            cut = bool(truncated[k] and not terminated[k])
            told[k] = _one(infos["final_info"], int(k))
            told[k] |= {"terminal_observation": infos["final_obs"][k], "TimeLimit.truncated": cut}
        return observations, rewards.astype(np.float32), ended, told

    def close(self) -> None:
        """Nothing is to be closed."""

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """An attribute, for each dose."""
        return [getattr(self.doses, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Sets an attribute of all."""
        setattr(self.doses, attr_name, value)

    def env_method(self, method_name: str, *arguments: Any, indices: Indices = None, **more: Any) -> list[Any]:
        """Calls a method once; its result, for each dose."""
        result = getattr(self.doses, method_name)(*arguments, **more)
        return [result for _ in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type[Any], indices: Indices = None) -> list[bool]:
        """No dose is wrapped."""
        return [False for _ in self._get_indices(indices)]


def _one(infos: dict[str, Any], k: int) -> dict[str, Any]:
    return {name: float(column[k]) for name, column in infos.items() if not name.startswith("_")}


def sac_policy_file(learner: Any, *, episodes: int = 0) -> tuple[str, bytes]:
    """The actor of a `stable_baselines3.SAC` as a policy file, which `flip policy infer` runs.

    Args:
        learner: a `SAC` with an `MlpPolicy` of ReLU layers, on an environment of this package.
        episodes: how many it was trained for, for the record.

    Returns:
        The policy's id and the file's bytes.

    Raises:
        ValueError: its network is of another kind.
    """
    actor, env = learner.policy.actor, learner.get_env()
    linear = [layer for layer in actor.latent_pi if hasattr(layer, "weight")]
    others = {type(layer).__name__ for layer in actor.latent_pi if not hasattr(layer, "weight")}
    if others - {"ReLU"}:
        raise ValueError(f"learner: its layers must have ReLU between them, not {', '.join(sorted(others))}")
    layers = [_layer(it) for it in linear]
    heads = [_layer(actor.mu), _layer(actor.log_std)]
    layers.append((np.hstack([weight for weight, _ in heads]), np.hstack([bias for _, bias in heads])))
    ours: Sequence[Any] = [env] if isinstance(env.unwrapped, FlipWeighVectorEnv) else env.get_attr("unwrapped")
    return policy_file(ours[0], layers, episodes=episodes)


def _layer(linear: Any) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    return linear.weight.detach().cpu().numpy().T, linear.bias.detach().cpu().numpy()
