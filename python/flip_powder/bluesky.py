"""Bluesky and ophyd-async: a doser that a plan sets to a mass and reads.

>>> from bluesky import RunEngine, plan_stubs as bps
>>> from ophyd_async.core import init_devices
>>> RE = RunEngine()
>>> with init_devices():
...     doser = Doser("salt", token="flip_…")
>>> def plan():
...     yield from bps.open_run()
...     yield from bps.mv(doser, 15.0)          # mg
...     yield from bps.create(); yield from bps.read(doser); yield from bps.save()
...     yield from bps.close_run()
>>> RE(plan())
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

from bluesky.protocols import Location, Stoppable
from ophyd_async.core import (
    AsyncLocatable,
    StandardReadable,
    StandardReadableFormat,
    WatchableAsyncStatus,
    WatcherUpdate,
    soft_signal_r_and_setter,
    soft_signal_rw,
)

from . import _flow
from ._async_client import AsyncClient
from ._mass import Tolerance
from ._records import Event, Weighing


class Doser(StandardReadable, AsyncLocatable[float], Stoppable):
    """A FLIP service as a device: set it to a mass in mg, then read what was weighed.

    Read: `reading` and `net`, `uncertainty` (k = 2), `target`, in mg; `outcome`, and `weighing`, the id of the record.
    Configuration: `powder`, `tolerance`, `vial`, `lot`; set them to change the next dose.

    A dose that misses its tolerance is a successful move with its outcome in the data. One that is aborted, stopped
    or has no known end fails the status.

    Args:
        powder: id of a calibrated powder.
        url, token: the service; default the environment's `FLIP_URL` and `FLIP_TOKEN`.
        tolerance: accepted error, one quantity with its unit.
        timeout_s: longest wait for a dose, s.
        name: name of the device.
    """

    def __init__(
        self,
        powder: str,
        url: str | None = None,
        token: str | None = None,
        *,
        tolerance: str = "1 mg",
        timeout_s: float | None = None,
        name: str = "",
    ) -> None:
        self._client = AsyncClient(url, token)
        self._timeout_s = timeout_s
        self._running: Weighing | None = None
        with self.add_children_as_readables(StandardReadableFormat.CONFIG_SIGNAL):
            self.powder = soft_signal_rw(str, powder)
            self.tolerance = soft_signal_rw(str, tolerance)
            self.vial = soft_signal_rw(str, "")
            self.lot = soft_signal_rw(str, "")
        with self.add_children_as_readables(StandardReadableFormat.HINTED_SIGNAL):
            self.reading, self._set_reading = soft_signal_r_and_setter(float, float("nan"), units="mg", precision=4)
        with self.add_children_as_readables():
            self.target, self._set_target = soft_signal_r_and_setter(float, float("nan"), units="mg", precision=4)
            self.net, self._set_net = soft_signal_r_and_setter(float, float("nan"), units="mg", precision=4)
            self.uncertainty, self._set_uncertainty = soft_signal_r_and_setter(
                float, float("nan"), units="mg", precision=4
            )
            self.outcome, self._set_outcome = soft_signal_r_and_setter(str, "")
            self.weighing, self._set_weighing = soft_signal_r_and_setter(str, "")
        super().__init__(name=name)

    @WatchableAsyncStatus.wrap
    async def set(self, value: float) -> AsyncIterator[WatcherUpdate[float]]:
        """Weighs `value` mg. Watchers get the balance's readings on the way."""
        self._set_target(float(value))
        body = await self._body(float(value))
        self._running = begun = await self._client.start_weighing(body)
        self._set_weighing(begun.id)
        events: asyncio.Queue[Event | None] = asyncio.Queue()
        waiting = asyncio.ensure_future(self._client.wait(begun, timeout=self._timeout_s, on_event=events.put_nowait))
        waiting.add_done_callback(lambda _: events.put_nowait(None))
        try:
            while (event := await events.get()) is not None:
                if event.kind == "tick":
                    shown = float(event.data["reading"]["mass_mg"])
                    yield WatcherUpdate(current=shown, initial=0.0, target=float(value), name=self.name, unit="mg")
            ended = await waiting
        finally:
            waiting.cancel()
        self._running = None
        self._show(ended)
        if ended.state != "done":
            ended.raise_for_outcome()

    async def locate(self) -> Location[float]:
        """The mass asked for and the last reading, mg."""
        return {"setpoint": await self.target.get_value(), "readback": await self.reading.get_value()}

    async def stop(self, success: bool = True) -> None:
        """Stops the dose in motion, if any; the RunEngine calls this after every plan."""
        running, self._running = self._running, None
        if running is not None:
            await self._client.stop(running)

    async def _body(self, target_mg: float) -> dict[str, object]:
        tolerance: Tolerance = await self.tolerance.get_value()
        asked = {"vial": await self.vial.get_value() or None, "lot": await self.lot.get_value() or None}
        return _flow.order(await self.powder.get_value(), f"{target_mg} mg", tolerance, asked, {})

    def _show(self, ended: Weighing) -> None:
        nothing = float("nan")
        self._set_outcome(ended.outcome or "")
        self._set_reading(nothing if ended.reading_mg is None else ended.reading_mg)
        self._set_net(ended.measured.net_mg if ended.measured else nothing)
        self._set_uncertainty(ended.measured.uncertainty_mg if ended.measured else nothing)
