#!/usr/bin/env python3
"""Blocks of six or more equal lines of Rust that stand twice in what is written by hand.

Compared are the lines that do something, without their whitespace. Left out are comments, tests, and what can only be
written out: `use` declarations, attributes, heads of functions, fields of types, and lines of a lone name (as in a
pattern that lists every field) or of nothing but closing brackets. Prints each block with its two places and exits with
1, or prints nothing.
"""

import pathlib
import re
import sys

ROOT = pathlib.Path(__file__).resolve().parent.parent
FOLDERS = ["src", "crates", "experiments", "examples"]
LEAST = 6
VISIBLE = r"(pub(\([^)]*\))? )?"
#: What to leave out, from a line that matches the first pattern to one whose end matches the second.
PASSAGES = [
    (re.compile(rf"\s*{VISIBLE}use "), re.compile(r";$")),
    (re.compile(r"\s*#!?\["), re.compile(r"\]$")),
    (re.compile(rf"\s*{VISIBLE}((const|async|unsafe) )*fn "), re.compile(r"[{;]$|\}$")),
    (re.compile(rf"\s*{VISIBLE}(struct|enum) "), re.compile(r"^\}$|;$|\}$")),
]
IDLE = re.compile(r"[\])};,?]*|\w+,")


def is_test(path):
    return path.name.endswith("tests.rs") or "tests" in path.relative_to(ROOT).parts or "target" in path.parts


def code(path):
    """Number and text of each line that counts."""
    lines, ends = [], None
    text = path.read_text().split("\n#[cfg(test)]\nmod ")[0]
    for number, line in enumerate(text.splitlines(), 1):
        line = re.sub(r"(^|\s)//.*", "", line).rstrip()
        if not line:
            continue
        ends = ends or next((end for start, end in PASSAGES if start.match(line)), None)
        if not ends:
            bare = "".join(line.split())
            if not IDLE.fullmatch(bare):
                lines.append((number, bare))
        elif ends.search(line):
            ends = None
    return lines


def repeats(files):
    """Pairs of places whose blocks are equal and as long as they can be: (file, index), (file, index), length."""
    first, found = {}, []
    for name, lines in files.items():
        for at in range(len(lines) - LEAST + 1):
            key = tuple(text for _, text in lines[at : at + LEAST])
            first.setdefault(key, []).append((name, at))
    for places in first.values():
        for k, one in enumerate(places):
            for other in places[k + 1 :]:
                if one[0] == other[0] and other[1] - one[1] < LEAST:
                    continue
                if not equal(files, one, other, -1):
                    length = LEAST
                    while equal(files, one, other, length):
                        length += 1
                    found.append((one, other, length))
    return found


def equal(files, one, other, by):
    """Whether the lines this far from the two places are equal; not across the end of a file."""
    places = [(files[name], at + by) for name, at in (one, other)]
    if any(not 0 <= at < len(lines) for lines, at in places):
        return False
    return places[0][0][places[0][1]][1] == places[1][0][places[1][1]][1]


def main():
    paths = sorted(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.rs") if not is_test(path))
    files = {str(path.relative_to(ROOT)): code(path) for path in paths}
    found = repeats(files)
    for one, other, length in found:
        first, second = (f"{name}:{files[name][at][0]}-{files[name][at + length - 1][0]}" for name, at in (one, other))
        print(f"{length} lines twice: {first} and {second}")
    sys.exit(1 if found else 0)


main()
