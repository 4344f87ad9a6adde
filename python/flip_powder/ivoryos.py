"""ivoryOS: FLIP as a flat class, whose methods become forms.

>>> import ivoryos
>>> from flip_powder.ivoryos import doser
>>> balance = doser(token="flip_…")
>>> ivoryos.run(__name__)
"""

# Annotations stay objects: ivoryOS reads them to make its forms, and an Enum becomes a drop-down list.

import enum
from typing import Any

from ._client import Client


class Doser:
    """Weighs powders with a FLIP service.

    :func:`doser` makes one whose powders are a drop-down list.
    """

    def __init__(self, url: str | None = None, token: str | None = None):
        self._client = Client(url, token)

    def dose(
        self,
        powder: str,
        target_mg: float,
        tolerance_mg: float = 1.0,
        vial: str = "",
        lot: str = "",
        operator: str = "",
    ) -> float:
        """Weigh a powder into the vial; returns the balance's reading, mg."""
        name = powder.value if isinstance(powder, enum.Enum) else powder
        weighing = self._client.weigh(
            str(name),
            f"{float(target_mg)} mg",
            tolerance=f"{float(tolerance_mg)} mg",
            vial=vial or None,
            lot=lot or None,
            operator=operator or None,
        )
        if weighing.state != "done" or weighing.reading_mg is None:
            weighing.raise_for_outcome()
        assert weighing.reading_mg is not None
        return weighing.reading_mg

    def angle_of_repose(self, powder: str) -> float:
        """The powder's measured angle of repose, degrees; -1 if nobody measured it."""
        name = powder.value if isinstance(powder, enum.Enum) else powder
        flowability = self._client.powder(str(name)).flowability
        return flowability.repose_deg if flowability else -1.0

    def bench_state(self) -> str:
        """What the bench is doing: `free`, `dosing`, or why it does not start."""
        bench = self._client.bench()
        return bench.blocked or ("dosing" if bench.moving else "free")

    def stop(self) -> None:
        """Stop everything that moves; the bench is then held until a person resumes."""
        self._client.stop_bench()


def doser(url: str | None = None, token: str | None = None) -> Doser:
    """A :class:`Doser` whose forms offer the powders of this service.

    Raises:
        UnreachableError: the service does not answer.
    """
    with Client(url, token) as client:
        names = {powder.id: powder.id for powder in client.powders()}
    powders = enum.Enum("Powders", names, module=__name__)  # type: ignore[misc]
    # ivoryOS finds an Enum again by module and name.
    globals()["Powders"] = powders

    def listed(method: Any) -> Any:
        def call(*args: Any, **kwargs: Any) -> Any:
            return method(*args, **kwargs)

        call.__name__, call.__doc__ = method.__name__, method.__doc__
        call.__signature__ = _offering(method, powders)  # type: ignore[attr-defined]
        return call

    methods = {name: listed(getattr(Doser, name)) for name in ("dose", "angle_of_repose")}
    return type("Doser", (Doser,), methods)(url, token)  # type: ignore[no-any-return]


def _offering(method: Any, powders: Any) -> Any:
    """The method's signature with a list of powders to choose from."""
    import inspect

    signature = inspect.signature(method)
    parameters = [it.replace(annotation=powders) if it.name == "powder" else it for it in signature.parameters.values()]
    return signature.replace(parameters=parameters)
