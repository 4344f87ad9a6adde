"""Masses and tolerances as people write them: "15 mg", "0.015 g", "5 %"."""

from __future__ import annotations

import re
from collections.abc import Sequence

_QUANTITY = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(\S+)\s*")

#: A tolerance: one mass or share for both sides, or (accepted shortfall, accepted excess).
Tolerance = str | Sequence[str]


def quantity(field: str, text: object, units: Sequence[str]) -> tuple[float, str]:
    """Splits a quantity into its value and its unit.

    Raises:
        ValueError: it has no unit, or another one; the message names the field.
    """
    found = _QUANTITY.fullmatch(text) if isinstance(text, str) else None
    if found is None or found[2] not in units:
        allowed = " or ".join(f'"15 {unit}"' for unit in units)
        raise ValueError(f"{field}: {text!r} is not a quantity with its unit: write {allowed}")
    return float(found[1]), found[2]


def target(text: str) -> dict[str, object]:
    """The `target` of a request to weigh."""
    value, unit = quantity("target", text, ("mg", "g"))
    return {"value": value, "unit": unit}


def tolerance(given: Tolerance) -> dict[str, object]:
    """The `tolerance` of a request to weigh.

    Raises:
        ValueError: not one or two quantities, or two of different units.
    """
    sides = [given] if isinstance(given, str) else list(given)
    if len(sides) not in (1, 2):
        raise ValueError("tolerance: give one quantity, or (shortfall, excess)")
    pairs = [quantity("tolerance", side, ("mg", "g", "%")) for side in sides]
    (lower, unit), (upper, other) = pairs[0], pairs[-1]
    if unit != other:
        raise ValueError(f"tolerance: {unit} and {other}: give both sides in one unit")
    return {"lower": lower, "upper": upper, "unit": unit}
