"""Makes `flip_powder/_client.py` from `flip_powder/_async_client.py`: `python3 python/unasync.py`, or `--check`.

The two clients differ in nothing but these words.
"""

import pathlib
import re
import sys

FOLDER = pathlib.Path(__file__).resolve().parent / "flip_powder"
WORDS = [
    (
        "The asynchronous client; `_client.py` is made from this file by `unasync.py`.",
        "The blocking client, made from `_async_client.py` by `unasync.py`.",
    ),
    ("import asyncio\n", ""),
    ("asyncio.sleep", "time.sleep"),
    ("AsyncBaseTransport", "BaseTransport"),
    ("AsyncClient", "Client"),
    ("AsyncIterator", "Iterator"),
    ("AsyncListing", "Listing"),
    ("__aenter__", "__enter__"),
    ("__aexit__", "__exit__"),
    ("aclose", "close"),
    ("aread", "read"),
    ("aiter_lines", "iter_lines"),
]


def blocking(text: str) -> str:
    """The blocking client for the asynchronous one."""
    for word, other in WORDS:
        text = text.replace(word, other)
    text = re.sub(r"\((await [^()]*\([^()]*(?:\{[^}]*\}[^()]*|\([^()]*\)[^()]*)*\))\)\.", r"\1.", text)
    text = re.sub(r"\b(async|await) ", "", text)
    # The order in which a linter wants the names of an import.
    return text.replace("import Iterator, Callable, Mapping", "import Callable, Iterator, Mapping")


def main() -> None:
    """Writes it, or checks that it is written."""
    made = blocking((FOLDER / "_async_client.py").read_text())
    path = FOLDER / "_client.py"
    if "--check" in sys.argv:
        if path.read_text() != made:
            sys.exit(f"{path} is not made from _async_client.py: run python3 python/unasync.py")
    else:
        path.write_text(made)


if __name__ == "__main__":
    main()
