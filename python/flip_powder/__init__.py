"""FLIP from Python: weigh powders, simulate them, learn to weigh them.

* :class:`Client` and :class:`AsyncClient` speak to a FLIP service.
* :mod:`flip_powder.sim` simulates heaps and spoons in this process.
* :mod:`flip_powder.env` has the Gymnasium environments `FlipWeigh-v0`.
* :mod:`flip_powder.pylabrobot`, `.bluesky`, `.ivoryos`, `.mlflow` and `.sb3` are adapters; each needs the package that
  it is named after.
* `flip_powder.api` has every operation of the REST interface, generated from the OpenAPI document.
"""

from ._async_client import AsyncClient
from ._client import Client
from ._flow import Answer, Retries
from ._native import VERSION
from ._problems import (
    BenchHeldError,
    ConflictError,
    FieldProblem,
    FlipError,
    JobFailedError,
    NotAllowedError,
    NotFoundError,
    OutcomeError,
    ProblemError,
    RefusedError,
    StillRunningError,
    UnavailableError,
    UncertainError,
    UnreachableError,
)
from ._records import (
    Action,
    Asked,
    BalanceReading,
    Bench,
    CalibratedSet,
    Event,
    Flowability,
    Hold,
    Job,
    MeasuredMass,
    Measurement,
    Policy,
    Powder,
    Progress,
    Reading,
    Tick,
    Weighing,
)
from ._tables import AsyncListing, Listing

__version__ = VERSION

__all__ = [
    "Action",
    "Answer",
    "Asked",
    "AsyncClient",
    "AsyncListing",
    "BalanceReading",
    "Bench",
    "BenchHeldError",
    "CalibratedSet",
    "Client",
    "ConflictError",
    "Event",
    "FieldProblem",
    "FlipError",
    "Flowability",
    "Hold",
    "Job",
    "JobFailedError",
    "Listing",
    "MeasuredMass",
    "Measurement",
    "NotAllowedError",
    "NotFoundError",
    "OutcomeError",
    "Policy",
    "Powder",
    "ProblemError",
    "Progress",
    "Reading",
    "RefusedError",
    "Retries",
    "StillRunningError",
    "Tick",
    "UnavailableError",
    "UncertainError",
    "UnreachableError",
    "Weighing",
]
