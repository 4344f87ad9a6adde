#!/usr/bin/env python3
"""Results that are older than the code they speak of: `make stale`.

A result says `*Recorded 2026-11-23, commit d40ad6d.* <!-- of crates/flip-sim/src -->`. Listed is each one whose code has
changed since that commit, with how many commits changed it and the newest of them. Comments and tests count too: a
person decides whether a change matters. Files that moved and changed in nothing but the paths they name do not count.
"""

import pathlib
import re
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parent.parent
LINE = re.compile(r"Recorded (\d{4}-\d\d-\d\d), commit ([0-9a-f]{7,40})[^<]*(?:<!-- of (.+?) -->)?")


def former(path):
    """Where the folder of a crate was before there were crates."""
    return re.sub(r"^crates/flip-(?:core|bench|learn)/src/", "src/", re.sub(r"^crates/flip-(sim|policy|discover|store)/src", r"src/\1", path))


def changes(commit, paths):
    """Commits since `commit` that changed one of the paths, newest first; None where git does not know the commit."""
    paths = sorted({*paths, *map(former, paths)})
    log = ["git", "-C", str(ROOT), "log", "--no-merges", "--diff-filter=AMD", "-M", "--format=%h %ad %s", "--date=short"]
    log += [f"{commit}..HEAD", "--", *paths]
    found = subprocess.run(log, capture_output=True, text=True)
    return found.stdout.splitlines() if found.returncode == 0 else None


def main():
    unknown = stale = results = 0
    for page in sorted(ROOT.glob("docs/**/*.md")):
        for number, line in enumerate(page.read_text().splitlines(), 1):
            match = LINE.search(line)
            if not match:
                continue
            results += 1
            date, commit, code = match.groups()
            place = f"{page.relative_to(ROOT)}:{number}"
            paths = (code or "").split()
            missing = [path for path in paths if not (ROOT / path).exists()]
            found = changes(commit, paths) if paths and not missing else None
            if found is None:
                unknown += 1
                why = f"no such path: {' '.join(missing)}" if missing else "names no code" if not paths else f"no such commit: {commit}"
                print(f"{place}  recorded {date}: {why}")
            elif found:
                stale += 1
                print(f"{place}  recorded {date}: {len(found)} commits since, the newest {found[0]}")
    print(f"{results} results, {stale} older than their code, {unknown} that cannot be told")
    return 1 if unknown else 0


if __name__ == "__main__":
    sys.exit(main())
