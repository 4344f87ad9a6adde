"""Gymnasium environments in which a learner weighs simulated powder.

`FlipWeigh-v0` is one dose after another: an action tilts and shakes the spoon, an observation is what the balance
shows. `gymnasium.make_vec("FlipWeigh-v0", num_envs=1024)` plays many in lockstep on all cores. Both are FLIP's own
decision process, played by the code that trains FLIP's own policies.

Example:
    >>> import gymnasium as gym
    >>> import flip_powder.env
    >>> env = gym.make("FlipWeigh-v0", preset="flip", readability_mg=0.1)
    >>> observation, info = env.reset(seed=1)
    >>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample())

**Action**: two numbers in -1..1: the change of the pitch (times 8 degrees) and the shake's amplitude (0 to 16 mm).

**Observation**: the inputs of a policy's network by the preset's encoding: `fall` (6 numbers) of the preset `flip`,
`paper` (3) of the preset `paper`; also `missing` (4) and `fall_and_repose` (7). docs/how-to/python.md has the formulas.

**Reward**: the preset's training reward for the *true* mass in the vial, mg. For `paper` it is the published one,
`D = -|target - true|`, plus 1 within 1 mg. For `flip` an overdose of more than 1 mg counts twice, and an early ending
is paid as if its last reward went on for ever (`/ (1 - gamma)`, gamma 0.9). `info["published_reward"]` has the
published one in both.

**Ending**: `terminated` when the target is reached or passed (preset `flip`), `truncated` after 10 steps.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, SupportsFloat, cast

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray

from . import _native
from .sim import ParameterSet, calibrate, checked_extensions

__all__ = ["ENV_ID", "FlipWeighEnv", "FlipWeighVectorEnv", "Level", "levels_at", "levels_of", "policy_file"]

#: The name under which both environments are registered, once this module is imported.
ENV_ID = "FlipWeigh-v0"

Preset = Literal["flip", "paper"]
Order = Literal["curriculum", "reverse", "random", "domain-randomisation"]
Pouring = Literal["surrogate", "simulator"]
Encoding = Literal["paper", "missing", "fall", "fall_and_repose"]


@dataclass(frozen=True, slots=True)
class Level:
    """A powder of a curriculum, and simulated powders that pile like it; an episode draws one."""

    #: Id of the powder.
    powder: str
    #: Its angle of repose, degrees.
    repose_deg: float
    #: Parameter sets by name of parameter.
    sets: Sequence[Mapping[str, float]]

    def _json(self) -> dict[str, Any]:
        sets = [dict(ParameterSet(it)) for it in self.sets]
        return {"powder": self.powder, "repose_deg": float(self.repose_deg), "sets": sets}


def levels_of(client: Any, powders: Iterable[str]) -> list[Level]:
    """The calibrated powders of a service as levels.

    Args:
        client: a `flip_powder.Client`.
        powders: ids of powders that are measured and calibrated.

    Raises:
        ValueError: a powder is not measured or not calibrated.
    """
    levels = []
    for name in powders:
        powder = client.powder(name)
        if powder.flowability is None or not powder.sets:
            raise ValueError(f"{name}: measure and calibrate it first")
        levels.append(Level(name, powder.flowability.repose_deg, [it.parameters for it in powder.sets]))
    return levels


def levels_at(angles_deg: Iterable[float], *, sets: int = 7, seed: int = 1, **settings: Any) -> list[Level]:
    """Levels of simulated powders that pile at these angles of repose, degrees: 28, 33 and 37 are the published
    curriculum's, with 7 sets each. Half a minute or so for each set; see `flip_powder.sim.calibrate`."""
    return [
        Level(f"{deg:g} deg", deg, [it.parameters for it in calibrate(deg, sets=sets, seed=seed, settings=settings)])
        for deg in angles_deg
    ]


def _settings(
    encoding: Encoding | None,
    target_mg: tuple[float, float] | None,
    readability_mg: float | None,
    steps_max: int | None,
    particles: int | None,
    extensions: Mapping[str, float] | None,
    box_share: float | None,
    settings: Mapping[str, Any] | None,
) -> str:
    """Changes of the preset's settings as JSON, under the names of the Rust code."""
    spoon = {"particles": particles, "extensions": checked_extensions(extensions or {})}
    changes: dict[str, Any] = {
        "encoding": encoding,
        "target_mg_min": target_mg[0] if target_mg else None,
        "target_mg_max": target_mg[1] if target_mg else None,
        "balance": {"readability_mg": readability_mg},
        "rules": {"steps_max": steps_max},
        "spoon": spoon,
        "box_share": box_share,
    }
    return json.dumps(_merged(_without_none(changes), settings or {}))


def _without_none(data: Mapping[str, Any]) -> dict[str, Any]:
    kept = {name: _without_none(it) if isinstance(it, Mapping) else it for name, it in data.items()}
    return {name: it for name, it in kept.items() if it is not None and it != {}}


def _merged(data: dict[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    for name, it in changes.items():
        both = isinstance(it, Mapping) and isinstance(data.get(name), dict)
        data[name] = _merged(data[name], it) if both else it
    return data


_Arrays = tuple[
    NDArray[np.float32],
    NDArray[np.float64],
    NDArray[np.bool_],
    NDArray[np.bool_],
    NDArray[np.float64],
    NDArray[np.float32],
    NDArray[np.float64],
]
_FACTS = tuple(_native.FACTS)
_F32, _F64, _BOOL = np.dtype(np.float32), np.dtype(np.float64), np.dtype(np.bool_)


def _masks(mask: NDArray[np.bool_]) -> dict[str, Any]:
    """The mask of every fact."""
    return {f"_{name}": mask for name in _FACTS}


def _infos(facts: NDArray[np.float64], masks: dict[str, Any]) -> dict[str, Any]:
    """Facts as Gymnasium's vector environments have them: an array and a mask for each."""
    return {**masks, **dict(zip(_FACTS, facts.T, strict=True))}


class _Doses:
    """Doses in lockstep with the arrays that they are told in."""

    def __init__(
        self,
        count: int,
        autoreset: str,
        preset: Preset,
        pouring: Pouring,
        levels: Sequence[Level] | None,
        order: Order | None,
        level: int | None,
        settings: str,
    ) -> None:
        if order is None:
            random: Order = "random" if level is None else "curriculum"
            order = random if levels else "domain-randomisation"
        text = json.dumps([it._json() for it in levels or ()])
        self.native = _native.Lockstep(count, pouring, autoreset, preset, order, text, settings)
        if level is not None:
            self.native.set_level(level)
        self.count, self.width = count, self.native.width
        self.last_inputs = np.zeros((count, self.width), np.float32)
        self.last_facts = np.zeros((count, len(_FACTS)), np.float64)
        self._inputs_shape, self._facts_shape = self.last_inputs.shape, self.last_facts.shape
        self.arrays = self.fresh()

    def fresh(self) -> _Arrays:
        """Arrays for the results of a step: observations, rewards, terminated, truncated, facts, and the last
        observations and facts of episodes that ended, which are the same ones each time."""
        empty, count = np.empty, self.count
        return (
            empty(self._inputs_shape, _F32),
            empty(count, _F64),
            empty(count, _BOOL),
            empty(count, _BOOL),
            empty(self._facts_shape, _F64),
            self.last_inputs,
            self.last_facts,
        )

    def spaces(self) -> tuple[gymnasium.spaces.Box, gymnasium.spaces.Box]:
        """Spaces of one observation and of one action."""
        low, high = (np.asarray(it, np.float32) for it in self.native.bounds())
        return gymnasium.spaces.Box(low, high, dtype=np.float32), gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)

    def choose(self, options: Mapping[str, Any] | None) -> None:
        """Options of a reset: `level` and `target_mg`, which hold until they are changed."""
        for name, value in (options or {}).items():
            if name == "level":
                self.native.set_level(value)
            elif name == "target_mg":
                self.native.set_target_mg(value)
            else:
                raise ValueError(f"options: there is no `{name}`; there are level, target_mg")


class FlipWeighEnv(gymnasium.Env[NDArray[np.float32], NDArray[np.float32]]):
    """One dose after another; see the module for action, observation, reward and ending.

    Args:
        preset: whose decision process: FLIP's own (`flip`) or the published robot's (`paper`).
        pouring: what is poured from: the fast `surrogate` of a spoon, microseconds a step, or the `simulator`, a third
            of a second a step.
        levels: powders to draw from; default none: every episode has a powder from the whole published box.
        order: how an episode's level is chosen. `random`, the default with levels; `curriculum` or `reverse`: the one
            at `level`, counted from the flattest or the steepest; `domain-randomisation`, the default without levels.
        level: the level to begin with, where the order is a curriculum's. `reset(options={"level": 1})` changes it.
        encoding: how observations are encoded; default the preset's.
        target_mg: lowest and highest target, mg; default 5 to 15. `reset(options={"target_mg": 12.0})` fixes it.
        readability_mg: display step of the balance, mg; default 1.
        steps_max: most steps of an episode; default 10.
        particles: grains in the simulator's spoon; default 2500, about 37 mg.
        extensions: amplitudes of mechanisms added to the simulator (`flip_powder.sim.EXTENSIONS`).
        box_share: share of episodes with a powder from the whole box, where there are levels; default the preset's.
        settings: any other setting of a training by its name, nested as in the property `settings`, which has them all:
            `{"balance": {"noise_mg": 0.2}, "overdose_factor": 1.0}`.
        render_mode: None; there is no other.

    Raises:
        ValueError: a setting or level is out of range; the message names it.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012

    def __init__(
        self,
        *,
        preset: Preset = "flip",
        pouring: Pouring = "surrogate",
        levels: Sequence[Level] | None = None,
        order: Order | None = None,
        level: int | None = None,
        encoding: Encoding | None = None,
        target_mg: tuple[float, float] | None = None,
        readability_mg: float | None = None,
        steps_max: int | None = None,
        particles: int | None = None,
        extensions: Mapping[str, float] | None = None,
        box_share: float | None = None,
        settings: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
    ) -> None:
        text = _settings(encoding, target_mg, readability_mg, steps_max, particles, extensions, box_share, settings)
        self._doses = _Doses(1, "disabled", preset, pouring, levels, order, level, text)
        observation, action = self._doses.spaces()
        self.observation_space, self.action_space = cast(Any, observation), cast(Any, action)
        self.render_mode = render_mode
        self._seeded = False

    @property
    def settings(self) -> dict[str, Any]:
        """Every setting in force."""
        return dict(json.loads(self._doses.native.settings))

    @property
    def parameters(self) -> NDArray[np.float32]:
        """The nine parameters of the present powder as fractions of their ranges: what a critic may know."""
        return cast(NDArray[np.float32], self._doses.native.parameters()[0])

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begins the next dose; with a seed, the first dose of that seed.

        Args:
            seed: seed of the doses from now on.
            options: `level` and `target_mg` from now on.
        """
        super().reset(seed=seed)
        if seed is None and not self._seeded:
            seed = int(self.np_random.integers(2**32))
        self._seeded = True
        self._doses.choose(options)
        self._doses.native.reset(None, [seed], self._doses.arrays)
        return self._doses.arrays[0][0].copy(), self._info()

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], SupportsFloat, bool, bool, dict[str, Any]]:
        """Carries out one action."""
        doses = self._doses
        doses.native.step(np.ascontiguousarray(action, np.float32).reshape(1, 2), doses.arrays)
        observations, rewards, terminated, truncated, *_ = doses.arrays
        ends = bool(terminated[0]), bool(truncated[0])
        return observations[0].copy(), float(rewards[0]), *ends, self._info()

    def _info(self) -> dict[str, Any]:
        return dict(zip(_FACTS, self._doses.arrays[4][0].tolist(), strict=True))


class FlipWeighVectorEnv(VectorEnv[NDArray[np.float32], NDArray[np.float32], NDArray[Any]]):
    """Many doses in lockstep on all cores, in compiled code without the interpreter's lock.

    `infos` has an array for each of the facts, and its mask, as Gymnasium's own vector environments have. Up to 64
    doses of the surrogate run on the calling thread.

    Args:
        num_envs: how many doses.
        autoreset_mode: when an episode that has ended gives way to the next: `NextStep` (default), at the following
            step, whose action is ignored; `SameStep`, at once, with `infos["final_obs"]` and `infos["final_info"]`;
            `Disabled`, by `reset(options={"reset_mask": …})`.
        copy: whether results are arrays of their own; without, the next step overwrites them.
        **more: as of :class:`FlipWeighEnv`.

    Raises:
        ValueError: a setting or level is out of range; the message names it.
    """

    def __init__(
        self,
        num_envs: int = 1,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        copy: bool = True,
        preset: Preset = "flip",
        pouring: Pouring = "surrogate",
        levels: Sequence[Level] | None = None,
        order: Order | None = None,
        level: int | None = None,
        encoding: Encoding | None = None,
        target_mg: tuple[float, float] | None = None,
        readability_mg: float | None = None,
        steps_max: int | None = None,
        particles: int | None = None,
        extensions: Mapping[str, float] | None = None,
        box_share: float | None = None,
        settings: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
    ) -> None:
        mode = autoreset_mode if isinstance(autoreset_mode, AutoresetMode) else AutoresetMode(autoreset_mode)
        names = {
            AutoresetMode.NEXT_STEP: "next_step",
            AutoresetMode.SAME_STEP: "same_step",
            AutoresetMode.DISABLED: "disabled",
        }
        text = _settings(encoding, target_mg, readability_mg, steps_max, particles, extensions, box_share, settings)
        self._doses = _Doses(num_envs, names[mode], preset, pouring, levels, order, level, text)
        self.num_envs, self.autoreset_mode, self.copy, self.render_mode = num_envs, mode, copy, render_mode
        self.metadata = {"render_modes": [], "autoreset_mode": mode}
        self.single_observation_space, self.single_action_space = self._doses.spaces()
        self.observation_space = gymnasium.vector.utils.batch_space(self.single_observation_space, num_envs)
        self.action_space = gymnasium.vector.utils.batch_space(self.single_action_space, num_envs)
        self._all = _masks(np.ones(num_envs, np.bool_))
        self._seeded = False

    @property
    def settings(self) -> dict[str, Any]:
        """Every setting in force."""
        return dict(json.loads(self._doses.native.settings))

    @property
    def parameters(self) -> NDArray[np.float32]:
        """The nine parameters of the present powders as fractions of their ranges, `[num_envs, 9]`: what a critic may
        know."""
        return self._doses.native.parameters()

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begins the next dose of each, or of those in `options["reset_mask"]`.

        Args:
            seed: `seed`, `seed + 1`, … for the doses in their order, or a list with one for each.
            options: `level` and `target_mg` from now on; `reset_mask`, a boolean array.
        """
        super().reset(seed=seed if isinstance(seed, int) else None)
        if seed is None and not self._seeded:
            seed = int(self.np_random.integers(2**32))
        self._seeded = True
        seeds = (
            [seed + k for k in range(self.num_envs)] if isinstance(seed, int) else list(seed or [None] * self.num_envs)
        )
        given = dict(options or {})
        mask = given.pop("reset_mask", None)
        if mask is not None and (not isinstance(mask, np.ndarray) or mask.dtype != np.bool_ or not mask.any()):
            raise ValueError("options: reset_mask must be a boolean array in which something is true")
        self._doses.choose(given)
        arrays = self._doses.fresh() if self.copy else self._doses.arrays
        self._doses.native.reset(mask, seeds, arrays)
        return arrays[0], _infos(arrays[4], self._all if mask is None else _masks(mask))

    def step(
        self, actions: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Carries out one action of each dose, `[num_envs, 2]`."""
        doses = self._doses
        arrays = doses.fresh() if self.copy else doses.arrays
        doses.native.step(np.ascontiguousarray(actions, np.float32), arrays)
        observations, rewards, terminated, truncated, facts, _, _ = arrays
        infos = _infos(facts, self._all)
        if self.autoreset_mode is AutoresetMode.SAME_STEP:
            ended = terminated | truncated
            if ended.any():
                infos |= self._final(ended)
        return observations, rewards, terminated, truncated, infos

    def _final(self, ended: NDArray[np.bool_]) -> dict[str, Any]:
        """What a `SameStep` tells of the episodes that ended."""
        observations = np.full(self.num_envs, None, object)
        for k in np.flatnonzero(ended):
            observations[k] = self._doses.last_inputs[k].copy()
        return {
            "final_obs": observations,
            "_final_obs": ended,
            "final_info": _infos(self._doses.last_facts.copy(), _masks(ended)),
            "_final_info": ended,
        }


def policy_file(
    env: Any, layers: Sequence[tuple[NDArray[Any], NDArray[Any]]], *, episodes: int = 0
) -> tuple[str, bytes]:
    """A network trained on an environment as a policy file of FLIP, which `flip policy infer --file` runs.

    Args:
        env: the environment, wrapped or not.
        layers: weight `[inputs, outputs]` and bias `[outputs]` of each layer, with ReLU between them. The last has
            four outputs: two means, before tanh, and two log standard deviations, as of Soft Actor-Critic.
        episodes: how many it was trained for, for the record.

    Returns:
        The policy's id and the file's bytes.

    Raises:
        ValueError: the layers do not fit each other or the environment's encoding.
    """
    weights = [np.asarray(weight, np.float32) for weight, _ in layers]
    widths = [weights[0].shape[0], *(weight.shape[1] for weight in weights)]
    blocks = [
        np.concatenate([w.reshape(-1), np.asarray(b, np.float32).reshape(-1)])
        for w, (_, b) in zip(weights, layers, strict=True)
    ]
    native = env.unwrapped._doses.native
    return _native.policy_file(native.settings, widths, np.concatenate(blocks).tolist(), episodes)


if ENV_ID not in gymnasium.registry:
    gymnasium.register(
        ENV_ID,
        entry_point="flip_powder.env:FlipWeighEnv",
        vector_entry_point="flip_powder.env:FlipWeighVectorEnv",
    )
