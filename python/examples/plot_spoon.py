"""Draws the grains of a heap and of a tilted spoon: `python plot_spoon.py FILE.png` (needs matplotlib)."""

import sys

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from flip_powder.sim import Heap, ParameterSet, Spoon

powder = ParameterSet(friction=0.6)
heap = Heap(powder, particles=1000)
spoon = Spoon(powder, particles=1000)
for _ in range(3):
    spoon.step(incline_change_deg=8.0, shake_mm=8.0)

figure, axes = plt.subplots(1, 2, figsize=(9, 4), subplot_kw={"aspect": "equal"})
for axis, seen, title in (
    (axes[0], heap.snapshot, f"{heap.tip_deg:.1f} deg"),
    (axes[1], spoon.snapshot, f"{spoon.vial_mg:.1f} mg poured"),
):
    axis.scatter(seen.centres_mm[:, 0], seen.centres_mm[:, 2], s=4)
    axis.set(title=title, xlabel="mm", ylabel="mm")
figure.savefig(sys.argv[1])
