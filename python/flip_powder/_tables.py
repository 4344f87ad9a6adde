"""Lists of the service: read page by page as they are needed, or as a table at once."""

from __future__ import annotations

import json
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from ._records import Record, moment

if TYPE_CHECKING:
    import pandas
    import pyarrow

R = TypeVar("R", bound=Record)
Page = tuple[list[Mapping[str, Any]], "str | None"]


def row(data: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """JSON as one row of a table: nested names joined by dots, times as such, lists as JSON text."""
    flat: dict[str, Any] = {}
    for name, value in data.items():
        name = prefix + name
        if isinstance(value, Mapping):
            flat |= row(value, f"{name}.")
        elif isinstance(value, list):
            flat[name] = json.dumps(value)
        elif name.endswith("_at") and isinstance(value, str):
            flat[name] = moment(value)
        else:
            flat[name] = value
    return flat


def columns(records: Iterable[Record]) -> dict[str, list[Any]]:
    """Rows as columns of equal length; what a row lacks is None."""
    rows = [row(record.raw) for record in records]
    names = dict.fromkeys(name for it in rows for name in it)
    return {name: [it.get(name) for it in rows] for name in names}


def pandas_of(records: Iterable[Record]) -> pandas.DataFrame:
    """A data frame with a column for each field.

    Raises:
        ImportError: pandas is missing: `pip install flip-powder[pandas]`.
    """
    import pandas

    frame: pandas.DataFrame = pandas.DataFrame(columns(records))
    return frame


def arrow_of(records: Iterable[Record]) -> pyarrow.Table:
    """An Arrow table with a column for each field.

    Raises:
        ImportError: pyarrow is missing: `pip install flip-powder[arrow]`.
    """
    import pyarrow

    table: pyarrow.Table = pyarrow.table(columns(records))
    return table


class Listing(Generic[R]):
    """A list of the service. Iterating reads it page by page, from the beginning each time.

    Example:
        >>> for weighing in client.weighings(powder="salt"): ...
        >>> client.weighings(outcome="over").to_pandas()
    """

    def __init__(self, read: Callable[[str | None], Page], of: Callable[[Mapping[str, Any]], R]) -> None:
        self._read, self._of = read, of

    def __iter__(self) -> Iterator[R]:
        after: str | None = None
        while True:
            items, after = self._read(after)
            yield from map(self._of, items)
            if after is None:
                return

    def to_pandas(self) -> pandas.DataFrame:
        """All of it as a pandas data frame, nested fields as `measured.net_mg`."""
        return pandas_of(self)

    def to_arrow(self) -> pyarrow.Table:
        """All of it as an Arrow table, nested fields as `measured.net_mg`."""
        return arrow_of(self)


class AsyncListing(Generic[R]):
    """:class:`Listing` for `async for`."""

    def __init__(self, read: Callable[[str | None], Awaitable[Page]], of: Callable[[Mapping[str, Any]], R]) -> None:
        self._read, self._of = read, of

    async def __aiter__(self) -> AsyncIterator[R]:
        after: str | None = None
        while True:
            items, after = await self._read(after)
            for item in items:
                yield self._of(item)
            if after is None:
                return

    async def all(self) -> list[R]:
        """All of it."""
        return [it async for it in self]

    async def to_pandas(self) -> pandas.DataFrame:
        """All of it as a pandas data frame, nested fields as `measured.net_mg`."""
        return pandas_of(await self.all())

    async def to_arrow(self) -> pyarrow.Table:
        """All of it as an Arrow table, nested fields as `measured.net_mg`."""
        return arrow_of(await self.all())
