"""What the service answers, as frozen dataclasses.

Names and units are those of the OpenAPI document. `raw` has everything that was answered, also fields that are newer
than this package.
"""

from __future__ import annotations

import dataclasses
import datetime
import functools
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypeVar

from ._problems import FlipError, OutcomeError

R = TypeVar("R", bound="Record")

#: State of a weighing; the last three are final.
WeighingState = Literal["planned", "awaiting_vial", "armed", "dosing", "settling", "done", "aborted", "unknown"]
#: How a weighing ended.
Outcome = Literal["within", "under", "over", "not_stable", "blocked", "probed", "stopped", "aborted", "unknown"]
#: State of a job; the last three are final.
JobState = Literal["queued", "running", "succeeded", "failed", "cancelled"]

ENDED_WEIGHING = frozenset({"done", "aborted", "unknown"})
ENDED_JOB = frozenset({"succeeded", "failed", "cancelled"})


@dataclass(frozen=True, slots=True, kw_only=True)
class Record:
    """Something the service answered."""

    #: Everything that was answered, as JSON.
    raw: Mapping[str, Any] = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def of(cls: type[R], data: Mapping[str, Any]) -> R:
        """Reads JSON; what the dataclass does not know stays in `raw`.

        Raises:
            FlipError: a field that every version answers is missing.
        """
        values: dict[str, Any] = {"raw": data}
        for name, kind, required in _fields(typing.cast(Any, cls)):
            value = data.get(name)
            if value is not None:
                values[name] = _value(kind, value)
            elif required:
                raise FlipError(f"the service's answer has no `{name}` of {cls.__name__}: is it another version?")
        return cls(**values)


@functools.cache
def _fields(cls: type[Record]) -> list[tuple[str, Any, bool]]:
    hints = typing.get_type_hints(cls)
    missing = dataclasses.MISSING
    return [
        (it.name, hints[it.name], it.default is missing and it.default_factory is missing)
        for it in dataclasses.fields(cls)
        if it.name != "raw"
    ]


def _value(kind: Any, value: Any) -> Any:
    """`value` from JSON as a `kind`."""
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin in (typing.Union, types.UnionType):
        return _value(next(it for it in arguments if it is not type(None)), value)
    if origin is tuple:
        return tuple(_value(arguments[0], it) for it in value)
    if isinstance(kind, type):
        if issubclass(kind, Record):
            return kind.of(value)
        if kind is datetime.datetime:
            return moment(value)
        if kind is float:
            return float(value)
    return value


def moment(text: str) -> datetime.datetime:
    """A point in time from RFC 3339."""
    # Python 3.10 reads neither a Z nor any number of digits.
    date, _, rest = text.removesuffix("Z").partition(".")
    read = datetime.datetime.fromisoformat(f"{date}.{rest:0<6.6}" if rest else date)
    return read if read.tzinfo else read.replace(tzinfo=datetime.timezone.utc)


@dataclass(frozen=True, slots=True, kw_only=True)
class Action(Record):
    """One motion of the spoon: incline, then shake."""

    #: Change of the pitch, degrees; positive is tip down.
    incline_change_deg: float
    #: Amplitude of a shake, mm; below 0.9 there is none.
    shake_mm: float
    #: How often the shake is made.
    strokes: int = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading(Record):
    """A reading of the balance."""

    #: Net mass shown, mg.
    mass_mg: float
    #: The balance's own flag.
    stable: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class BalanceReading(Record):
    """What the balance shows outside of a dose."""

    #: Mass shown, mg: net of what was tared last.
    mass_mg: float
    #: The balance's own flag.
    stable: bool
    at: datetime.datetime
    #: Its display step, mg, where known.
    readability_mg: float | None = None
    #: How it identified itself at the last dose, if there was one.
    balance: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Tick(Record):
    """One step of a weighing, and the reading after it."""

    #: Number of the step; 0 is the reading after the tare.
    step: int
    #: Time since the tare, s.
    t_s: float
    #: Pitch of the spoon, degrees.
    pitch_deg: float
    action: Action
    reading: Reading
    #: Which filling of the spoon, from 1.
    spoonful: int = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredMass(Record):
    """What was measured besides the final reading."""

    #: Mass of the powder, mg.
    net_mg: float
    #: Its expanded uncertainty (k = 2), mg.
    uncertainty_mg: float
    #: Whether the balance said stable at the last reading.
    stable_by_balance: bool
    #: Whether FLIP's own criterion said so.
    stable_by_window: bool
    #: Whether the outcome holds over the whole uncertainty; None if it does not concern the tolerance.
    proven: bool | None = None
    tare_mg: float | None = None
    gross_mg: float | None = None
    #: Doses made before this one and discarded, mg.
    discarded_mg: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Asked(Record):
    """Circumstances given with a weighing."""

    lot: str | None = None
    vial: str | None = None
    operator: str | None = None
    list: str | None = None
    position: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Weighing(Record):
    """One dose: the order, and how it ended."""

    id: str
    #: Id of the powder.
    powder: str
    #: Mass asked for, mg.
    target_mg: float
    #: Accepted shortfall and excess, mg.
    tolerance_lower_mg: float
    tolerance_upper_mg: float
    #: Id of the policy that dosed.
    policy: str
    #: Id of the simulated powder.
    parameter_set: str
    state: WeighingState
    created_at: datetime.datetime
    started_at: datetime.datetime | None = None
    finished_at: datetime.datetime | None = None
    outcome: Outcome | None = None
    #: Final reading, mg; None if there is none, as for an aborted dose.
    reading_mg: float | None = None
    #: Reading minus target, mg.
    error_mg: float | None = None
    #: True mass, mg; known only in simulation.
    dispensed_mg: float | None = None
    shakes: int | None = None
    #: Bench time, s.
    seconds: float | None = None
    measured: MeasuredMass | None = None
    #: Kind of the bench: `simulated`, `emulated` or `devices`.
    bench: str | None = None
    asked: Asked = field(default_factory=Asked)
    #: What the caller attached.
    labels: Mapping[str, str] = field(default_factory=dict)
    #: Why it was aborted.
    error: str | None = None
    #: Its steps; empty in a list of weighings.
    ticks: tuple[Tick, ...] = field(default=(), repr=False)

    @property
    def ended(self) -> bool:
        """Whether its state is final."""
        return self.state in ENDED_WEIGHING

    def raise_for_outcome(self) -> Weighing:
        """Returns itself if it ended within its tolerance.

        Raises:
            OutcomeError: it ended otherwise, or has not ended.
        """
        if self.outcome != "within":
            raise OutcomeError(self)
        return self

    @classmethod
    def of_detail(cls, data: Mapping[str, Any]) -> Weighing:
        """Reads the answer to a request for one weighing, which has the ticks beside it."""
        return cls.of({**data["weighing"], "ticks": data.get("ticks") or []})


@dataclass(frozen=True, slots=True, kw_only=True)
class Progress(Record):
    """How far a job is."""

    #: Share done, 0 to 1.
    fraction: float
    message: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Job(Record):
    """Something computed: a calibration, a training, an evaluation."""

    id: str
    kind: str
    state: JobState
    progress: Progress
    created_at: datetime.datetime
    started_at: datetime.datetime | None = None
    finished_at: datetime.datetime | None = None
    #: Time left, s, once the pace is known.
    left_s: float | None = None
    #: Why it failed.
    error: str | None = None

    @property
    def ended(self) -> bool:
        """Whether its state is final."""
        return self.state in ENDED_JOB


@dataclass(frozen=True, slots=True, kw_only=True)
class Measurement(Record):
    """A measured angle of repose."""

    id: str
    #: Mean angle, degrees.
    repose_deg: float
    #: Standard deviation of the repeats, degrees.
    sd_deg: float
    #: Number of repeats.
    n: int
    method: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Flowability(Record):
    """The angle of repose that calibrations aim at."""

    #: Mean angle, degrees.
    repose_deg: float
    #: Standard deviation of the repeats, degrees.
    sd_deg: float
    #: Number of repeats.
    n: int


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibratedSet(Record):
    """A simulated powder that piles like a measured one."""

    id: str
    #: The nine parameters by name: what `flip_powder.sim` and `flip_powder.env` take.
    parameters: Mapping[str, float]
    #: Mean simulated angle of repose, degrees.
    repose_deg: float
    #: Simulations behind it.
    runs: int
    #: Simulated minus measured angle, absolute, degrees.
    error_deg: float
    powder: str | None = None
    calibration: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Powder(Record):
    """A registered powder; `measurements` and `sets` are empty in a list of powders."""

    id: str
    name: str
    created_at: datetime.datetime
    #: Its newest measurement; None if nobody measured it.
    flowability: Flowability | None = None
    measurements: tuple[Measurement, ...] = ()
    sets: tuple[CalibratedSet, ...] = ()

    @classmethod
    def of_detail(cls, data: Mapping[str, Any]) -> Powder:
        """Reads the answer to a request for one powder."""
        more = {name: data.get(name) or [] for name in ("measurements", "sets")}
        return cls.of({**data["powder"], **more})


@dataclass(frozen=True, slots=True, kw_only=True)
class Policy(Record):
    """What decides the spoon's next motion."""

    id: str
    #: `learned`, `recurrent`, `paced`, `dispenser`, …
    kind: str
    created_at: datetime.datetime
    #: The training that made it.
    training: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Hold(Record):
    """Why nothing starts on the bench, and since when."""

    at: datetime.datetime
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Bench(Record):
    """The bench, and whether it may be used."""

    kind: str | None = None
    #: Devices by role.
    devices: Mapping[str, str] = field(default_factory=dict)
    #: After a stop: nothing starts until a person resumes.
    held: Hold | None = None
    #: Why nobody may use it until a person has checked.
    latch: Hold | None = None
    #: The weighing in motion.
    moving: str | None = None

    @property
    def blocked(self) -> str | None:
        """Why nothing starts, or None."""
        hold = self.latch or self.held
        return hold.reason if hold else None


@dataclass(frozen=True, slots=True, kw_only=True)
class Event(Record):
    """Something that happened to a job or a weighing."""

    #: Place in the order of all events.
    seq: int
    #: `weighing:<id>`, `job:<id>`, `bench`, …
    topic: str
    #: `state` or `tick` of a weighing; `state`, `progress`, `trial` or `episode` of a job.
    kind: str
    data: Mapping[str, Any]
    at: datetime.datetime
