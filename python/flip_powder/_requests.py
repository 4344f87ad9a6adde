"""What both clients are made from: where the service is, and the bodies and paths of its operations."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any
from urllib.parse import quote

from ._flow import Retries

#: Where a service listens unless told otherwise.
URL = "http://127.0.0.1:8080"
#: A read that waits longer than this for a byte is broken off, s. The service sends one every 15 s even on an idle
#: stream.
TIMEOUT_S = 30.0

#: How often what may be repeated is tried again by default.
RETRIES = Retries()

AGENT = "flip-powder"


class Settings:
    """Where the service is and how to speak to it."""

    def __init__(self, url: str | None, token: str | None, timeout_s: float, retries: Retries | int) -> None:
        self.url = (url or os.environ.get("FLIP_URL") or URL).rstrip("/").removesuffix("/v1")
        self.token = token or os.environ.get("FLIP_TOKEN")
        self.timeout_s = timeout_s
        self.retries = retries if isinstance(retries, Retries) else Retries(retries)

    def headers(self) -> dict[str, str]:
        """Headers of every request."""
        headers = {"user-agent": AGENT, "accept": "application/json"}
        return headers | ({"authorization": f"Bearer {self.token}"} if self.token else {})

    def __repr__(self) -> str:
        # Never the token.
        return f"url={self.url!r}, token={'given' if self.token else None}"


def part(text: str) -> str:
    """Text as one part of a path."""
    return quote(text, safe="")


def asked(
    vial: str | None,
    lot: str | None,
    operator: str | None,
    position: str | None,
    retry_overdose: int | None,
    more: Mapping[str, Any] | None,
) -> dict[str, Any]:
    """The circumstances of a dose."""
    overdose = None if retry_overdose is None else {"action": "discard_and_retry", "max": retry_overdose}
    given = {"vial": vial, "lot": lot, "operator": operator, "position": position, "on_overdose": overdose}
    return given | dict(more or {})
