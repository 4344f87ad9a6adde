"""A real `flip serve` on a folder of its own, and environments with clients that others wrote.

Nothing is installed where the tests run: a client lives in a virtual environment below target/clients, with pinned versions, and a script there drives
it in a process of its own. Without a network, and without the environment from an earlier run, its tests are skipped with the reason.
"""

import functools
import json
import os
import pathlib
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import unittest
import urllib.error
import urllib.request

ROOT = pathlib.Path(__file__).resolve().parents[2]
HERE = pathlib.Path(__file__).resolve().parent
TARGET = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
BINARY = os.environ.get("FLIP_BIN", str(TARGET / "release/flip"))
ENVIRONMENTS = TARGET / "clients"

# A powder that is ready to weigh in seconds: two sets, of heaps with few grains.
POWDER = "sand"
CALIBRATION = {"powder": POWDER, "method": "sequential", "sets": 2, "tolerance_deg": 5, "trials_max": 60, "particles": 400}

# Names of the tokens in every data folder.
ADMIN, OPERATOR = "admin", "scheduler"


def skip(reason):
    print(f"skipped: {reason}", file=sys.stderr, flush=True)
    raise unittest.SkipTest(reason)


def flip(*arguments):
    """A command of the program; what it prints."""
    done = subprocess.run([BINARY, *map(str, arguments), "--json"], capture_output=True, text=True, timeout=300)
    if done.returncode != 0:
        raise RuntimeError(f"flip {' '.join(map(str, arguments))}: {done.stdout}{done.stderr}")
    return json.loads(done.stdout)


class Service:
    """`flip serve` with these arguments beside those of every test's."""

    def __init__(self, *arguments, folder=None):
        if not pathlib.Path(BINARY).exists():
            raise FileNotFoundError(f"no binary at {BINARY}: run cargo build --release, or set FLIP_BIN")
        self.home = folder or pathlib.Path(tempfile.mkdtemp(prefix="flip-clients-"))
        self.data, self.arguments = self.home / "data", arguments
        self.tokens = self.home / "tokens.json"
        if not self.tokens.exists():
            made = {name: self.token(name, role) for name, role in [(ADMIN, "admin"), (OPERATOR, "operator")]}
            self.tokens.write_text(json.dumps(made))
        self.secrets = json.loads(self.tokens.read_text())
        self.log = open(self.home / "log.txt", "ab")
        self.start()

    @classmethod
    def ready(cls, *arguments):
        """The same with a powder that can be weighed."""
        home = pathlib.Path(tempfile.mkdtemp(prefix="flip-clients-"))
        shutil.copytree(calibrated(), home, dirs_exist_ok=True)
        return cls(*arguments, folder=home)

    def token(self, name, role):
        return flip("token", "create", "--data-dir", self.data, "--name", name, "--role", role)["token"]

    def start(self):
        command = [BINARY, "serve", "--json", "--listen", "127.0.0.1:0", "--data-dir", str(self.data), *self.arguments]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=self.log)
        said, decoder = b"", json.JSONDecoder()
        while True:
            line = self.process.stdout.readline()
            said += line
            try:
                self.said, _ = decoder.raw_decode(said.decode().lstrip())
                break
            except ValueError:
                if not line:
                    raise RuntimeError(f"flip serve does not begin: {self.logged()}") from None
        if "url" not in self.said:
            self.process.wait()
            self.process.stdout.close()
            raise RuntimeError(f"flip serve does not begin: {self.said}")
        self.url = self.said["url"]

    @property
    def sila(self):
        """Host and port of the SiLA server."""
        host, _, port = self.said["sila"].removeprefix("sila://").rpartition(":")
        return [host, port]

    def kill(self):
        """SIGKILL: no destructor, no last word."""
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()
        self.process.stdout.close()

    def stop(self):
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
            try:
                self.process.wait(30)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        self.process.stdout.close()
        self.log.close()
        shutil.rmtree(self.home, ignore_errors=True)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.stop()

    def logged(self):
        return (self.home / "log.txt").read_text(errors="replace")[-4000:]

    def ask(self, method, path, body=None, headers=(), who=ADMIN):
        """One call of REST; refuses anything but 2xx."""
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(self.url + path, data, method=method)
        request.add_header("authorization", f"Bearer {self.secrets[who]}")
        if data is not None:
            request.add_header("content-type", "application/json")
        for name, value in dict(headers).items():
            request.add_header(name, value)
        try:
            with urllib.request.urlopen(request, timeout=60) as answer:
                return json.loads(answer.read())
        except urllib.error.HTTPError as error:
            raise RuntimeError(f"{method} {path}: {error.code} {error.read().decode(errors='replace')}") from error

    def get(self, path):
        return self.ask("GET", path)

    def post(self, path, body, **headers):
        return self.ask("POST", path, body, headers)

    def until(self, path, done, seconds=300):
        """What is at a path once `done` says so of it."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            found = self.get(path)
            if done(found):
                return found
            time.sleep(0.2)
        raise TimeoutError(f"{path} after {seconds} s: {found}\n{self.logged()}")

    def calibrate(self):
        job = self.post("/v1/calibrations", CALIBRATION)
        ended = self.until(f"/v1/jobs/{job['id']}", lambda it: it["state"] not in ("queued", "running"))
        if ended["state"] != "succeeded":
            raise RuntimeError(f"the calibration ended as {ended}")

    def ended(self, weighing, seconds=300):
        """A weighing once it has ended."""
        return self.until(f"/v1/weighings/{weighing}", lambda it: it["weighing"]["outcome"], seconds)["weighing"]


@functools.cache
def calibrated():
    """A folder with a calibrated powder, made once and copied."""
    service = Service()
    service.calibrate()
    service.process.send_signal(signal.SIGTERM)
    service.process.wait(60)
    service.process.stdout.close()
    service.log.close()
    return service.home


@functools.cache
def environment(name, *packages):
    """The Python of a virtual environment with these packages; made once."""
    folder = ENVIRONMENTS / name
    python, wanted, has = folder / "bin/python", "\n".join(packages), folder / "packages.txt"
    if python.exists() and has.exists() and has.read_text() == wanted:
        return str(python)
    shutil.rmtree(folder, ignore_errors=True)
    folder.parent.mkdir(parents=True, exist_ok=True)
    made = subprocess.run([sys.executable, "-m", "venv", str(folder)], capture_output=True, text=True)
    if made.returncode != 0:
        skip(f"python3 -m venv does not work here: {made.stderr or made.stdout}")
    install = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--retries", "1", *packages]
    done = subprocess.run(install, capture_output=True, text=True)
    if done.returncode != 0:
        shutil.rmtree(folder, ignore_errors=True)
        skip(f"{', '.join(packages)} cannot be installed here: {done.stderr.strip().splitlines()[-1] if done.stderr.strip() else 'pip failed'}")
    has.write_text(wanted)
    return str(python)


def drive(python, script, *arguments, seconds=300):
    """Runs a script of this folder in an environment; the JSON document that it prints last."""
    # MADSci keeps logs in the folder where it runs.
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run([python, str(HERE / script), *map(str, arguments)], capture_output=True, text=True, timeout=seconds, cwd=folder)
    lines = done.stdout.strip().splitlines()
    if done.returncode != 0 or not lines:
        raise AssertionError(f"{script} {' '.join(map(str, arguments))} failed:\n{done.stdout}\n{done.stderr}")
    return json.loads(lines[-1])
