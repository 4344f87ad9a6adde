#!/usr/bin/env python3
"""The README's commands, as a reader would type them: `python3 .ci/readme.py [BINARY]`.

The first dose in four calls and the investigation are run as they stand. Every other `flip` command takes minutes to
hours: its flags are checked by the program itself, with `--help` behind them.
"""
import json
import os
import pathlib
import re
import shlex
import subprocess
import sys
import tempfile
import time

ROOT = pathlib.Path(__file__).resolve().parent.parent
FLIP = pathlib.Path(sys.argv[1] if len(sys.argv) > 1 else ROOT / "target/release/flip").resolve()
README = (ROOT / "README.md").read_text()


def commands():
    """Each `flip …` of a fenced block or between backticks, without its comment."""
    blocks = re.findall(r"```sh\n(.*?)```", README, re.S)
    spoken = re.findall(r"`(flip [^`]+)`", README)
    lines = [line for block in blocks for line in block.splitlines() if line.startswith("flip ")]
    return [shlex.split(line, comments=True)[1:] for line in lines + spoken]


def bash(line, **names):
    done = subprocess.run(["bash", "-euc", line], capture_output=True, text=True, env={**os.environ, **names})
    if done.returncode != 0:
        sys.exit(f"{line}\n{done.stderr}")
    return done.stdout


def until(what, ask, limit_s):
    """What `ask` returns once it is something, asked twice a second."""
    end = time.monotonic() + limit_s
    while time.monotonic() < end:
        found = ask()
        if found:
            return found
        time.sleep(0.5)
    sys.exit(f"{what}: nothing after {limit_s} s")


def first_dose(folder):
    """The block of calls, line by line, with the identifiers that a reader would copy."""
    block = re.search(r"```sh\n(TOKEN=.*?)```", README, re.S)[1].replace("\\\n", " ")
    setting, helper, calibrate, job, weigh, result = block.strip().splitlines()
    serve = [FLIP, "serve", "--bench", "emulated", "--listen", "127.0.0.1:0", "--json", "--data-dir", folder / "served"]
    with subprocess.Popen(serve, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as service:
        try:
            said, _ = json.JSONDecoder().raw_decode("".join(iter(service.stdout.readline, "}\n")) + "}")
            setting = setting.replace("flip_…", said["token"]).replace("http://127.0.0.1:8080", said["url"])
            call = lambda line: json.loads(bash(f"{setting}\n{helper}\n{line}"))
            ask = lambda line, id: call(line.replace("ID", id))
            one = call(calibrate)["id"]
            until("the calibration", lambda: ask(job, one)["state"] == "succeeded", 300)
            dose = call(weigh)["id"]
            poured = until("the dose", lambda: (found := ask(result, dose)["weighing"])["outcome"] and found, 900)
            print(f"first dose: {poured['outcome']}")
            assert poured["outcome"] in ("within", "under", "over", "blocked"), poured
        finally:
            service.terminate()


def main():
    for words in commands():
        subprocess.run([FLIP, *words, "--help"], check=True, stdout=subprocess.DEVNULL)
        print(f"flags of flip {' '.join(words)}")
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        discover = next(words for words in commands() if words[:2] == ["discover", "--measurements"])
        words = [str(folder / "found") if word == "found" else word for word in discover]
        subprocess.run([FLIP, *words, "--data-dir", folder / "data"], check=True, stdout=subprocess.DEVNULL, cwd=ROOT)
        print(f"flip {' '.join(discover)}")
        first_dose(folder)


main()
