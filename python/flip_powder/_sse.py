"""Server-sent events, as far as the service uses them."""

from __future__ import annotations

import json

from ._records import Event


class Lines:
    """Puts lines of a stream together to events."""

    def __init__(self) -> None:
        self._data: list[str] = []

    def feed(self, line: str) -> Event | None:
        """The event that this line completes, if it does. A comment, which keeps the connection open, completes
        none."""
        if line:
            name, _, value = line.partition(":")
            if name == "data":
                self._data.append(value.removeprefix(" "))
            return None
        data, self._data = "\n".join(self._data), []
        return Event.of(json.loads(data)) if data else None
