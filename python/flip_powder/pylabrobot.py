"""PyLabRobot: FLIP as the backend of a `PowderDispenser`, and its balance as the backend of a `Scale`.

>>> from pylabrobot.powder_dispensing import PowderDispenser
>>> from pylabrobot.resources import Powder
>>> dispenser = PowderDispenser(FlipPowderDispenserBackend(token="flip_…"))
>>> await dispenser.setup()
>>> await dispenser.dispense(plate["A1"], Powder("salt"), 15.0, tolerance="1 mg")
[{'actual_amount': 14.9, 'outcome': 'within', …}]

PyLabRobot calls amounts "mg, S.I." and shows 0.005 in an example. Here an amount is in **mg**. A `Scale` reads
**grams**.

>>> from pylabrobot.scales import Scale
>>> scale = Scale("balance", 200, 300, 300, FlipScaleBackend(token="flip_…"))
>>> await scale.setup()
>>> await scale.read_weight()
12.0004
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping
from typing import Any, Literal

from pylabrobot.machines.backend import MachineBackend
from pylabrobot.powder_dispensing.backend import DispenseResults, PowderDispense, PowderDispenserBackend
from pylabrobot.scales.scale_backend import ScaleBackend

from ._async_client import AsyncClient
from ._mass import Tolerance
from ._problems import FlipError
from ._records import Bench, Weighing

#: How often the balance is asked whether it is stable, s.
LOOK_S = 0.1


class _Backend(MachineBackend):
    """The connection to the service."""

    def __init__(self, url: str | None, token: str | None) -> None:
        super().__init__()
        self.url, self.token = url, token
        self.client: AsyncClient | None = None

    async def setup(self) -> None:
        """Connects.

        Raises:
            FlipError: the service cannot be reached, or its bench cannot be used now.
        """
        self.client = AsyncClient(self.url, self.token)
        try:
            why = self._unusable(await self.client.bench())
            if why:
                raise FlipError(why)
        except BaseException:
            await self.stop()
            raise

    def _unusable(self, bench: Bench) -> str | None:
        """Why this backend cannot use the bench, or None."""
        return f"the bench does not start: {bench.blocked}" if bench.blocked else None

    async def stop(self) -> None:
        """Closes the connection. What is being weighed goes on; `client.stop_bench()` stops that."""
        if self.client is not None:
            await self.client.aclose()
            self.client = None

    def _connected(self) -> AsyncClient:
        if self.client is None:
            raise RuntimeError("The setup has not finished. See `setup`.")
        return self.client


class FlipPowderDispenserBackend(_Backend, PowderDispenserBackend):
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
        super().__init__(url, token)
        self.tolerance = tolerance
        self.powders = dict(powders or {})

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
        client = self._connected()
        results = []
        for dose in dispense_parameters:
            asked = {"tolerance": self.tolerance, "vial": dose.resource.name} | dose.kwargs | backend_kwargs
            weighing = await client.weigh(self._powder(dose.powder.name), f"{float(dose.amount)} mg", **asked)
            results.append(_result(weighing))
        return results

    def _powder(self, name: str) -> str:
        return self.powders.get(name, name.strip().lower().replace(" ", "_"))

    def serialize(self) -> dict[str, Any]:
        """Everything but the token."""
        more = {"url": self.url, "tolerance": self.tolerance, "powders": self.powders}
        return {**super().serialize(), **more}


class FlipScaleBackend(_Backend, ScaleBackend):
    """Reads, tares and zeroes the balance of a FLIP service between doses.

    While a dose or a pile is made, every method raises `ConflictError`: then the balance is FLIP's own.

    Args:
        url: the service; default the environment's `FLIP_URL`.
        token: its token; default the environment's `FLIP_TOKEN`. It is not serialised.
        reservation: id of the bench's reservation, sent with every tare and zero.
        stable_within_s: longest wait for a stable reading, s.
    """

    def __init__(
        self,
        url: str | None = None,
        token: str | None = None,
        reservation: str | None = None,
        stable_within_s: float = 60.0,
    ) -> None:
        super().__init__(url, token)
        self.reservation, self.stable_within_s = reservation, stable_within_s

    def _unusable(self, bench: Bench) -> str | None:
        if bench.kind == "simulated":
            return "a simulated bench has no balance: start the service with an emulated bench or with devices"
        return None

    async def zero(self) -> None:
        """Sets the balance's zero point, with an empty pan.

        Raises:
            ConflictError: a dose is being made, the bench is latched or reserved, or the load is beyond the balance's
                zero range.
            FlipError: as `flip_powder.AsyncClient.zero_balance`.
        """
        await self._connected().zero_balance(reservation=self.reservation)

    async def tare(self) -> None:
        """Tares the balance with what is on it, once the reading is stable.

        Raises:
            ConflictError: a dose is being made, or the bench is latched or reserved.
            FlipError: as `flip_powder.AsyncClient.tare_balance`.
        """
        await self._connected().tare_balance(reservation=self.reservation)

    async def read_weight(self, timeout: Literal["stable"] | float = "stable") -> float:
        """What the balance shows, **g**.

        Args:
            timeout: as other scales of PyLabRobot have it. `"stable"` waits for a stable reading; a number of seconds
                waits at most so long and then takes what is shown; 0 takes it at once.

        Raises:
            ConflictError: a dose is being made, or the balance failed.
            FlipError: `"stable"`, and no reading was stable within `stable_within_s`; or as
                `flip_powder.AsyncClient.balance`.
        """
        client = self._connected()
        wait_s = self.stable_within_s if timeout == "stable" else float(timeout)
        ends = time.monotonic() + wait_s
        while True:
            reading = await client.balance()
            left = ends - time.monotonic()
            if reading.stable or (timeout != "stable" and left <= 0.0):
                return reading.mass_mg / 1000.0
            if left <= 0.0:
                raise FlipError(f"no stable reading within {wait_s:g} s; the last was {reading.mass_mg:g} mg")
            await asyncio.sleep(min(LOOK_S, left))

    def serialize(self) -> dict[str, Any]:
        """Everything but the token."""
        more = {"url": self.url, "reservation": self.reservation, "stable_within_s": self.stable_within_s}
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
