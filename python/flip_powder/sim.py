"""FLIP's simulator in this process: heaps, spoons, calibration.

Everything runs in compiled code without the interpreter's lock, so Python's threads may simulate at the same time;
what takes many (`heaps`, `step_all`, `calibrate`) uses all cores by itself (`RAYON_NUM_THREADS` sets how many). The
same arguments give the same bits on every machine.

Example:
    >>> salt = ParameterSet(friction=0.6, cohesion=0.1)
    >>> Heap(salt, seed=1).tip_deg
    >>> spoon = Spoon(salt, seed=1)
    >>> spoon.step(incline_change_deg=8.0, shake_mm=12.0).vial_mg
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from . import _native
from ._native import Snapshot
from ._problems import FlipError

__all__ = [
    "EXTENSIONS",
    "PARAMETERS",
    "SIMULATOR",
    "Calibrated",
    "Heap",
    "Parameter",
    "ParameterSet",
    "Poured",
    "SimulationError",
    "Snapshot",
    "Spoon",
    "calibrate",
    "heaps",
    "step_all",
]

#: Version of the simulator's physics.
SIMULATOR = _native.SIMULATOR


class SimulationError(FlipError):
    """A heap without an angle, or a calibration that found too little; it says why."""


class Parameter(NamedTuple):
    """One of the nine parameters of a simulated powder."""

    key: str
    #: Unit; empty if it has none.
    unit: str
    #: Published bounds, inclusive.
    lower: float
    upper: float
    default: float
    #: What it does.
    meaning: str


#: The nine parameters, in their order.
PARAMETERS = tuple(Parameter(*row) for row in _native.parameters())
_KEYS = tuple(parameter.key for parameter in PARAMETERS)

#: Mechanisms that may be added to the simulator, with the largest sensible amplitude of each.
EXTENSIONS = dict(_native.extensions())


class ParameterSet(Mapping[str, float]):
    """A simulated powder: a value for each of the nine parameters (:data:`PARAMETERS`), by name.

    Args:
        values: values by name, as a service answers them (`powder.sets[0].parameters`); what is missing has its
            default.
        **more: further values by name.

    Raises:
        ValueError: an unknown name, or a value out of its bounds; the message names it.
    """

    __slots__ = ("_values",)

    def __init__(self, values: Mapping[str, float] | None = None, /, **more: float) -> None:
        given = {**(values or {}), **more}
        unknown = sorted(given.keys() - set(_KEYS))
        if unknown:
            raise ValueError(f"{unknown[0]}: is not one of the nine parameters, {', '.join(_KEYS)}")
        self._values = tuple(float(given.get(it.key, it.default)) for it in PARAMETERS)
        _native.set_id(self._values)

    @classmethod
    def from_unit(cls, fractions: Sequence[float]) -> ParameterSet:
        """The set with these nine fractions of the published ranges, 0 to 1."""
        if len(fractions) != len(PARAMETERS):
            raise ValueError(f"fractions: must be {len(PARAMETERS)} numbers")
        values = zip(PARAMETERS, fractions, strict=True)
        return cls({it.key: min(max(it.lower + x * (it.upper - it.lower), it.lower), it.upper) for it, x in values})

    @property
    def values_in_order(self) -> tuple[float, ...]:
        """The values in the order of :data:`PARAMETERS`."""
        return self._values

    @property
    def id(self) -> str:
        """Its content address, `ps-…`, as a service gives it."""
        return _native.set_id(self._values)

    def with_(self, **changes: float) -> ParameterSet:
        """The set with some values changed."""
        return ParameterSet(self, **changes)

    def __getitem__(self, key: str) -> float:
        if key not in _KEYS:
            raise KeyError(key)
        return self._values[_KEYS.index(key)]

    def __iter__(self) -> Iterator[str]:
        return iter(_KEYS)

    def __len__(self) -> int:
        return len(_KEYS)

    def __hash__(self) -> int:
        return hash(self._values)

    def __eq__(self, other: object) -> bool:
        return self._values == other._values if isinstance(other, ParameterSet) else NotImplemented

    def __repr__(self) -> str:
        changed = {it.key: x for it, x in zip(PARAMETERS, self._values, strict=True) if x != it.default}
        return f"ParameterSet({', '.join(f'{key}={x!r}' for key, x in changed.items())})"


Set = Mapping[str, float]


def _values(given: Set) -> tuple[float, ...]:
    return (given if isinstance(given, ParameterSet) else ParameterSet(given)).values_in_order


def _settings(extensions: Mapping[str, float] | None, settings: Mapping[str, Any] | None, **more: Any) -> str:
    """Settings as JSON, under the names of the Rust code."""
    merged = {name: it for name, it in more.items() if it is not None} | dict(settings or {})
    return json.dumps(merged | ({"extensions": checked_extensions(extensions)} if extensions else {}))


def checked_extensions(extensions: Mapping[str, float]) -> dict[str, float]:
    """The amplitudes, each within its bounds.

    Raises:
        ValueError: an unknown mechanism, or an amplitude out of its bounds; the message names it.
    """
    for name, amplitude in extensions.items():
        if name not in EXTENSIONS:
            raise ValueError(f"extensions: there is no `{name}`; there are {', '.join(EXTENSIONS)}")
        if not 0.0 <= amplitude <= EXTENSIONS[name]:
            raise ValueError(f"extensions.{name}: must be between 0 and {EXTENSIONS[name]:g}, got {amplitude}")
    return {name: float(amplitude) for name, amplitude in extensions.items()}


def _checked_action(incline_change_deg: float, shake_mm: float, strokes: float) -> tuple[float, float, int]:
    """An action that the spoon can carry out."""
    if not math.isfinite(incline_change_deg):
        raise ValueError(f"incline_change_deg: must be a number, got {incline_change_deg}")
    if not 0.0 <= shake_mm <= 16.0:
        raise ValueError(f"shake_mm: must be between 0 and 16 mm, got {shake_mm}")
    if not 1 <= strokes <= 8:
        raise ValueError(f"strokes: must be from 1 to 8, got {strokes}")
    return float(incline_change_deg), float(shake_mm), int(strokes)


class Heap:
    """A heap poured from a simulated powder, and its angle of repose. It takes a second or so of a core.

    Args:
        parameters: the powder.
        particles: grains poured; the base grows with them.
        seed: seed of the pouring.
        readings: readings of the angle; between two of them part of the heap is renewed.
        extensions: amplitudes of added mechanisms (:data:`EXTENSIONS`).
        settings: further settings of the heap experiment by name.

    Raises:
        ValueError: something is out of its bounds; the message names it.
        SimulationError: the heap has no angle, and why.
    """

    def __init__(
        self,
        parameters: Set,
        *,
        particles: int = 2000,
        seed: int = 1,
        readings: int = 1,
        extensions: Mapping[str, float] | None = None,
        settings: Mapping[str, Any] | None = None,
    ) -> None:
        text = _settings(extensions, settings, readings=readings)
        try:
            self._heap = _native.Heap(_values(parameters), seed, particles, text)
        except RuntimeError as error:
            raise SimulationError(str(error)) from None

    @classmethod
    def _of(cls, heap: _native.Heap) -> Heap:
        made = cls.__new__(cls)
        made._heap = heap
        return made

    @property
    def tip_deg(self) -> float:
        """Angle of repose from the apex, as a camera sees it, degrees; mean over the readings."""
        return self._heap.tip_deg

    @property
    def tip_sd_deg(self) -> float | None:
        """Its standard deviation over the readings, degrees; None for a single one."""
        return self._heap.tip_sd_deg

    @property
    def cone_deg(self) -> float:
        """Slope of a cone fitted to the flank, degrees; mean over the readings."""
        return self._heap.cone_deg

    @property
    def creep_deg_per_s(self) -> float:
        """Change of that slope over the last 0.2 s, degrees per second."""
        return self._heap.creep_deg_per_s

    @property
    def particles_on_base(self) -> int:
        """Grains that stayed on the base."""
        return self._heap.particles_on_base

    @property
    def simulated_s(self) -> float:
        """Simulated time, s."""
        return self._heap.simulated_s

    @property
    def snapshot(self) -> Snapshot:
        """The grains at the end: `centres_mm` `[grains, 3]`, `radii_mm` `[grains]`, for plotting."""
        return self._heap.snapshot()

    def __repr__(self) -> str:
        return f"<Heap of {self.particles_on_base} grains at {self.tip_deg:.2f} deg>"


def heaps(
    parameters: Iterable[Set],
    *,
    seeds: Iterable[int] | None = None,
    particles: int = 2000,
    readings: int = 1,
    extensions: Mapping[str, float] | None = None,
    settings: Mapping[str, Any] | None = None,
) -> list[Heap | SimulationError]:
    """Pours a heap of each powder, on all cores.

    Args:
        parameters: the powders.
        seeds: a seed for each; default 1, 2, 3, …
        particles, readings, extensions, settings: as of a :class:`Heap`.

    Returns:
        A heap for each powder, in their order, or the reason why it has no angle.
    """
    sets = [_values(it) for it in parameters]
    chosen = list(range(1, len(sets) + 1) if seeds is None else seeds)
    if len(chosen) != len(sets):
        raise ValueError(f"seeds: {len(chosen)} for {len(sets)} powders")
    text = _settings(extensions, settings, readings=readings)
    rows = _native.heaps(sets, chosen, particles, text)
    return [Heap._of(heap) if heap is not None else SimulationError(why) for heap, why in rows]


class Poured(NamedTuple):
    """What one action poured."""

    #: Mass that fell into the vial, mg.
    vial_mg: float
    #: Mass that missed it, mg.
    spilled_mg: float
    #: Duration of the motion and of the powder coming to rest, s.
    duration_s: float


class Spoon:
    """A spoon filled with a simulated powder, over a vial.

    Filling takes about a second of a core, an action a third of one. Copy a filled spoon to pour from the same heap
    again.

    Args:
        parameters: the powder.
        particles: grains in the spoon; 2500 are about 37 mg.
        seed: seed of the filling.
        extensions: amplitudes of added mechanisms (:data:`EXTENSIONS`).
        settings: further settings of the spoon by name.

    Raises:
        ValueError: something is out of its bounds; the message names it.
    """

    def __init__(
        self,
        parameters: Set,
        *,
        particles: int = 2500,
        seed: int = 1,
        extensions: Mapping[str, float] | None = None,
        settings: Mapping[str, Any] | None = None,
    ) -> None:
        text = _settings(extensions, settings, particles=particles)
        self._spoon = _native.Spoon(_values(parameters), seed, text)

    def step(self, incline_change_deg: float, shake_mm: float, strokes: int = 1) -> Poured:
        """Inclines, shakes, and waits until the powder rests.

        Args:
            incline_change_deg: change of the pitch, degrees; positive is tip down. The pitch stays within its range.
            shake_mm: amplitude of a shake along the spoon, 0 to 16 mm; below 0.9 there is none.
            strokes: how often to shake, 1 to 8.

        Raises:
            ValueError: a number out of its bounds; the message names it.
        """
        return Poured(*self._spoon.step(*_checked_action(incline_change_deg, shake_mm, strokes)))

    def film(
        self, incline_change_deg: float, shake_mm: float, strokes: int = 1, *, every_s: float = 0.01
    ) -> tuple[Poured, list[Snapshot]]:
        """:meth:`step`, with a snapshot of the grains in the spoon every `every_s` of simulated time."""
        poured, frames = self._spoon.film(*_checked_action(incline_change_deg, shake_mm, strokes), every_s)
        return Poured(*poured), frames

    @property
    def pitch_deg(self) -> float:
        """Pitch, degrees; positive is tip down."""
        return self._spoon.pitch_deg

    @property
    def vial_mg(self) -> float:
        """Powder in the vial, mg: the true mass."""
        return self._spoon.vial_mg

    @property
    def spilled_mg(self) -> float:
        """Powder that missed the vial, mg."""
        return self._spoon.spilled_mg

    @property
    def spoon_mg(self) -> float:
        """Powder left in the spoon, mg."""
        return self._spoon.spoon_mg

    @property
    def fault(self) -> str | None:
        """Why the simulation's numbers mean nothing any more; None if they do."""
        return self._spoon.fault

    @property
    def snapshot(self) -> Snapshot:
        """The grains in the spoon, in its frame: `centres_mm` `[grains, 3]`, `radii_mm` `[grains]`."""
        return self._spoon.snapshot()

    def copy(self) -> Spoon:
        """The same spoon with the same heap."""
        made = Spoon.__new__(Spoon)
        made._spoon = self._spoon.copy()
        return made

    __copy__ = copy

    def __deepcopy__(self, memo: dict[int, Any]) -> Spoon:
        return self.copy()


def step_all(spoons: Sequence[Spoon], actions: Sequence[Sequence[float]]) -> list[Poured]:
    """One action of each spoon, on all cores.

    Args:
        spoons: different spoons.
        actions: for each the change of its pitch, degrees, the amplitude, mm, and, if it is not 1, the strokes.
    """
    rows = [_checked_action(it[0], it[1], it[2] if len(it) > 2 else 1) for it in actions]
    return [Poured(*row) for row in _native.step_all([spoon._spoon for spoon in spoons], rows)]


class Calibrated(NamedTuple):
    """A simulated powder that piles at a wanted angle."""

    parameters: ParameterSet
    #: Mean angle of its verification heaps, degrees.
    repose_deg: float
    #: Simulated minus wanted angle, absolute, degrees.
    error_deg: float


def calibrate(
    repose_deg: float, *, sets: int = 1, seed: int = 1, settings: Mapping[str, Any] | None = None
) -> list[Calibrated]:
    """Finds powders that pile at an angle, on all cores: half a minute or so for each. A service that is at hand finds
    better ones (`Client.calibrate`).

    Args:
        repose_deg: angle of repose, degrees.
        sets: how many powders.
        seed: seed of the search.
        settings: further settings of the method `sequential` by name: `tolerance_deg`, `particles`, `trials_max`, …

    Raises:
        ValueError: something is out of its bounds; the message names it.
        SimulationError: too few were found.
    """
    try:
        found = _native.calibrate(repose_deg, sets, json.dumps({"seed": seed, **(settings or {})}))
    except RuntimeError as error:
        raise SimulationError(str(error)) from None
    of = [parameter.key for parameter in PARAMETERS]
    return [
        Calibrated(ParameterSet(dict(zip(of, values, strict=True))), angle, error) for values, angle, error in found
    ]
