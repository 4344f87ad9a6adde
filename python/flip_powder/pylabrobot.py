"""PyLabRobot: FLIP as the backend of a `PowderDispenser`.

>>> from pylabrobot.powder_dispensing import PowderDispenser
>>> from pylabrobot.resources import Powder
>>> dispenser = PowderDispenser(FlipPowderDispenserBackend(token="flip_…"))
>>> await dispenser.setup()
>>> await dispenser.dispense(plate["A1"], Powder("salt"), 15.0, tolerance="1 mg")
[{'actual_amount': 14.9, 'outcome': 'within', …}]

PyLabRobot calls amounts "mg, S.I." and shows 0.005 in an example. Here an amount is in **mg**.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pylabrobot.powder_dispensing.backend import DispenseResults, PowderDispense, PowderDispenserBackend

from ._async_client import AsyncClient
from ._mass import Tolerance
from ._problems import FlipError
from ._records import Weighing


class FlipPowderDispenserBackend(PowderDispenserBackend):
    """Weighs each amount with a FLIP service, one after another.

    Args:
        url: the service; default the environment's `FLIP_URL`.
        token: its token; default the environment's `FLIP_TOKEN`. It is not serialised.
        tolerance: accepted error of every amount, unless `dispense` is called with another.
        powders: ids of FLIP's powders by the names of PyLabRobot's, where they differ.
    """

    def __init__(
        self,
        url: str | None = None,
        token: str | None = None,
        tolerance: Tolerance = "1 mg",
        powders: Mapping[str, str] | None = None,
    ) -> None:
        super().__init__()
        self.url, self.token, self.tolerance = url, token, tolerance
        self.powders = dict(powders or {})
        self.client: AsyncClient | None = None

    async def setup(self) -> None:
        """Connects.

        Raises:
            FlipError: the service cannot be reached, or its bench is held until a person has looked.
        """
        self.client = AsyncClient(self.url, self.token)
        blocked = (await self.client.bench()).blocked
        if blocked:
            await self.stop()
            raise FlipError(f"the bench does not start: {blocked}")

    async def stop(self) -> None:
        """Closes the connection. What is being weighed goes on; `client.stop_bench()` stops that."""
        if self.client is not None:
            await self.client.aclose()
            self.client = None

    async def dispense(self, dispense_parameters: list[PowderDispense], **backend_kwargs: Any) -> list[DispenseResults]:
        """Weighs the amounts, in mg, in their order.

        Args:
            dispense_parameters: resource (its name is recorded as the vial), powder and amount, mg.
            **backend_kwargs: as `flip_powder.AsyncClient.weigh` takes them: `tolerance`, `lot`, `operator`,
                `timeout`, …

        Returns:
            For each the balance's last reading as `actual_amount`, mg, with `outcome`, `uncertainty_mg` and the id of
            the `weighing`.

        Raises:
            OutcomeError: a dose was aborted, stopped or has no known end; the ones after it are not begun.
            FlipError: as `weigh`.
        """
        if self.client is None:
            raise RuntimeError("The setup has not finished. See `setup`.")
        results = []
        for dose in dispense_parameters:
            asked = {"tolerance": self.tolerance, "vial": dose.resource.name} | dose.kwargs | backend_kwargs
            weighing = await self.client.weigh(self._powder(dose.powder.name), f"{float(dose.amount)} mg", **asked)
            results.append(_result(weighing))
        return results

    def _powder(self, name: str) -> str:
        return self.powders.get(name, name.strip().lower().replace(" ", "_"))

    def serialize(self) -> dict[str, Any]:
        """Everything but the token."""
        more = {"url": self.url, "tolerance": self.tolerance, "powders": self.powders}
        return {**super().serialize(), **more}


def _result(weighing: Weighing) -> DispenseResults:
    if weighing.reading_mg is None or weighing.state != "done":
        weighing.raise_for_outcome()
    uncertainty = weighing.measured.uncertainty_mg if weighing.measured else None
    return DispenseResults(
        actual_amount=weighing.reading_mg,
        outcome=weighing.outcome,
        uncertainty_mg=uncertainty,
        weighing=weighing.id,
    )
