"""Simulates heaps and spoons with flip_powder.sim. Prints one JSON document."""

import json
import threading
import time

import numpy as np

from flip_powder.sim import (
    EXTENSIONS,
    PARAMETERS,
    Heap,
    ParameterSet,
    SimulationError,
    Spoon,
    calibrate,
    heaps,
    step_all,
)

found: dict[str, object] = {"parameters": [it.key for it in PARAMETERS], "extensions": sorted(EXTENSIONS)}
easy, hard = ParameterSet(friction=0.2), ParameterSet(friction=0.9)
found["sets"] = [easy.id != hard.id, easy == ParameterSet(dict(easy)), ParameterSet.from_unit([0.5] * 9)["friction"]]
errors = []
for wrong in ({"friction": 9.0}, {"stickiness": 1.0}):
    try:
        ParameterSet(wrong)
    except ValueError as error:
        errors.append(str(error).split(":")[0])
found["refused"] = errors

both = heaps([easy, hard], particles=600, seeds=[1, 1])
alone = Heap(hard, particles=600, seed=1)
found["heaps"] = [both[1].tip_deg == alone.tip_deg, both[0].tip_deg < both[1].tip_deg]
seen = alone.snapshot
top = (seen.centres_mm[:, 2] + seen.radii_mm).max()
found["snapshot"] = [len(seen) == alone.particles_on_base, seen.centres_mm.shape[1], seen.centres_mm.dtype.name, bool(top > 1.0)]
try:
    Heap(easy, particles=20, settings={"base_radius_diameters": 9.0})
except SimulationError as error:
    found["no_angle"] = "pour more particles" in str(error)
wet = Heap(easy, particles=600, extensions={"humidity": 1.0})
found["wet_is_steeper"] = wet.tip_deg > both[0].tip_deg

spoon = Spoon(easy, particles=600, seed=2)
full = spoon.spoon_mg
other = spoon.copy()
poured = [spoon.step(8.0, 12.0).vial_mg for _ in range(3)]
found["spoon"] = [spoon.vial_mg > 0.0, abs(sum(poured) - spoon.vial_mg) < 1e-9, abs(full - spoon.spoon_mg - spoon.vial_mg - spoon.spilled_mg) < 1e-9]
film: list[object] = []
for _ in range(3):
    more, frames = other.film(8.0, 12.0, every_s=0.02)
    film += frames
found["film"] = [len(film) > 5, other.vial_mg == spoon.vial_mg]
pair = [Spoon(easy, particles=600, seed=2), Spoon(hard, particles=600, seed=2)]
for _ in range(3):
    step_all(pair, [(8.0, 12.0), (8.0, 12.0)])
found["step_all"] = [pair[0].vial_mg == spoon.vial_mg, pair[1].vial_mg < pair[0].vial_mg]

# The interpreter's lock is released: this thread counts while another simulates.
counted, done = 0, threading.Event()
thread = threading.Thread(target=lambda: (Spoon(hard, particles=2500), done.set()))
begun = time.monotonic()
thread.start()
while not done.is_set():
    counted += 1
    time.sleep(0.001)
found["lock_released"] = counted > 20 * (time.monotonic() - begun)

(powder,) = calibrate(33.0, settings={"particles": 400, "tolerance_deg": 5.0, "trials_max": 60})
found["calibrated"] = [abs(powder.repose_deg - 33.0) <= 5.0, powder.parameters.id[:3]]
assert isinstance(seen.centres_mm, np.ndarray)
print(json.dumps(found))
