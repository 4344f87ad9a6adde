"""The Python package flip-powder, as built into a wheel and installed into environments that hold nothing else of FLIP.

Checked by the third parties' own code: Gymnasium's and Stable-Baselines3's checkers, PyLabRobot's dispenser, Bluesky's RunEngine, a running ivoryOS, MLflow.
Each script `with_python_*.py` prints what it saw; what that must be stands here.
"""

import functools
import os
import pathlib
import re
import subprocess
import sys
import tempfile
import time
import unittest
import zipfile

import service

sys.path.insert(0, str(service.ROOT / "python"))

import build  # noqa: E402

ROOT = service.ROOT
DOCS = ROOT / "docs/how-to/python.md"
# Stable-Baselines3 with its torch is 3 GB to fetch, which the gate does not: the environment that `make bench-learner` makes serves.
LEARNER = pathlib.Path(os.environ.get("LEARNER_VENV", pathlib.Path.home() / ".cache/flip-learner"))
BASE = ["httpx==0.28.1", "numpy==2.4.6"]
PLAIN = ["python", *BASE, "attrs==26.1.0", "gymnasium==1.4.0", "pandas==3.1.1", "pyarrow==26.0.1", "mypy==2.4.1", "ruff==0.17.6", "pandas-stubs"]
ADAPTERS = ["python-adapters", *BASE, "pylabrobot==0.2.2", "bluesky==1.15.1", "ophyd-async==0.21.3", "ivoryos==1.7.2", "mlflow-skinny==3.17.2", "alembic"]


@functools.cache
def wheel():
    """Builds the wheel in the profile of the tests: of FLIP's crates, only two are not compiled for them already."""
    try:
        programs = build.tools(build.TOOLS)
    except subprocess.CalledProcessError as error:
        service.skip(f"maturin cannot be installed here: {error}")
    crates = subprocess.run(["cargo", "metadata", "--locked", "--format-version", "1"], cwd=ROOT, capture_output=True, text=True)
    if crates.returncode != 0:
        service.skip(f"the wheel's crates cannot be fetched here: {crates.stderr.strip().splitlines()[-1]}")
    build.generate(programs)
    made = build.build(programs, service.ENVIRONMENTS / "wheel", profile="dev")
    print(f"{made.name} {made.stat().st_size / 1e6:.2f} MB", file=sys.stderr)
    return made


@functools.cache
def python(name, *packages):
    """The Python of an environment with these packages and the wheel of this build."""
    program = service.environment(name, *packages)
    install(program, wheel())
    return program


# Without bytecode of modules that nobody imports.
PIP = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-compile"]


def install(program, package):
    subprocess.run([program, *PIP, "--force-reinstall", "--no-deps", str(package)], check=True)


def plain():
    return python(*PLAIN)


def adapters():
    return python(*ADAPTERS)


@functools.cache
def learner():
    """The Python of an environment with Stable-Baselines3."""
    program = LEARNER / "bin/python"
    if not program.exists():
        service.skip(f"Stable-Baselines3 and its torch are 3 GB: `make bench-learner`, or LEARNER_VENV, has them, and {LEARNER} does not")
    if not any(LEARNER.glob("lib/python*/site-packages/httpx")):
        subprocess.run([program, *PIP, BASE[0]], check=True)
    install(program, wheel())
    return str(program)


def snippets(heading):
    """The blocks of Python in a section of the documentation."""
    section = re.search(rf"^## {heading}\n(.*?)(?=^## |\Z)", DOCS.read_text(), re.M | re.S)
    return re.findall(r"^```python\n(.*?)^```", section[1], re.M | re.S)


def readme():
    """The blocks of Python in the README: one that weighs, one that trains."""
    return re.findall(r"^```python\n(.*?)^```", (ROOT / "README.md").read_text(), re.M | re.S)


def swapped(code, old, new):
    """The same code with something smaller in it."""
    if old not in code:
        raise AssertionError(f"no {old} in\n{code}")
    return code.replace(old, new)


def few_grains(code):
    """The same code with a calibration that takes one second of a processor and not twelve."""
    return swapped(code, "sets=2)", "sets=2, particles=400, tolerance_deg=5, trials_max=60)")


def run(program, code, *arguments, **environment):
    """Runs a snippet, or a file, in a folder of its own; what it printed."""
    with tempfile.TemporaryDirectory() as folder:
        command = [program, *(["-c", code] if "\n" in code else [code]), *map(str, arguments)]
        # Two learners' threads that wait for each other on two cores take ten times as long as one.
        where = {**os.environ, "OMP_NUM_THREADS": "1", "CUDA_VISIBLE_DEVICES": "", **environment}
        done = subprocess.run(command, capture_output=True, text=True, cwd=folder, env=where, timeout=600)
    if done.returncode != 0:
        raise AssertionError(f"{code}\n{done.stdout}\n{done.stderr}")
    return done.stdout


class Package(unittest.TestCase):
    def test_the_wheel_is_one_for_all_pythons_small_and_without_libtorch(self):
        path = wheel()
        self.assertRegex(path.name, r"^flip_powder-\d+\.\d+\.\d+-cp310-abi3-manylinux\w+\.whl$")
        self.assertLess(path.stat().st_size, 6e6)
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
            metadata = archive.read(next(name for name in names if name.endswith("METADATA"))).decode()
        self.assertIn("flip_powder/py.typed", names)
        self.assertIn("flip_powder/api/client.py", names)
        self.assertEqual([name for name in names if "torch" in name or name.endswith(".pyc")], [])
        needed = [line for line in metadata.splitlines() if line.startswith("Requires-Dist") and "extra ==" not in line]
        self.assertEqual(sorted(re.split(r"[ <>=,]", line.removeprefix("Requires-Dist: "))[0] for line in needed), ["httpx", "numpy"])

    def test_it_installs_into_an_empty_environment_by_pip_alone(self):
        with tempfile.TemporaryDirectory() as folder:
            subprocess.run([sys.executable, "-m", "venv", folder], check=True)
            done = subprocess.run([f"{folder}/bin/python", *PIP, str(wheel())], capture_output=True, text=True)
            if done.returncode != 0:
                service.skip(f"httpx and numpy cannot be installed here: {done.stderr.strip().splitlines()[-1]}")
            said = run(f"{folder}/bin/python", "import flip_powder, flip_powder.sim as sim\nprint(flip_powder.__version__, sim.SIMULATOR)")
        self.assertRegex(said, r"^0\.\d+\.\d+ pbd-\d+$")

    def test_the_blocking_client_is_the_asynchronous_one_without_its_awaits(self):
        subprocess.run([sys.executable, str(ROOT / "python/unasync.py"), "--check"], check=True)

    def test_types_and_style_are_clean(self):
        program = service.environment(*PLAIN)
        for check in (["mypy"], ["ruff", "check", "."], ["ruff", "format", "--check", "."]):
            done = subprocess.run([program, "-m", *check], cwd=ROOT / "python", capture_output=True, text=True)
            self.assertEqual(done.returncode, 0, done.stdout + done.stderr)


class Client(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.python = plain()
        cls.service = service.Service.ready()
        cls.addClassCleanup(cls.service.stop)

    def test_both_clients_weigh_wait_and_name_what_is_wrong(self):
        secret = self.service.secrets[service.OPERATOR]
        found = service.drive(self.python, "with_python_client.py", self.service.url, secret, service.POWDER)
        self.assertEqual(found["dose"], {"outcome": found["dose"]["outcome"], "state": "done", "vial": "A1", "lot": "L7"})
        for name in ("close", "events", "events_again", "hasty_events", "same_key", "uncalibrated", "trace", "token_is_secret", "async_events", "async_list", "generated"):
            self.assertTrue(found[name], name)
        self.assertEqual(found["ticks"], [True, True])
        self.assertEqual(found["stop_of_an_ended_one"], "done")
        self.assertEqual(found["lost_answers"], {"asked": 3, "poured": 1, "state": "done"})
        self.assertEqual(found["other_body"], 422)
        self.assertEqual(found["refusals"], {"powder": True, "target": True, "target.value": True})
        self.assertEqual([found["wrong_token"], found["any_request"]], [401, 200])
        self.assertEqual(found["pandas"], [True, "A1", True])
        self.assertEqual(found["arrow"][1], "double")
        self.assertEqual(found["powder"], [True, 2])
        self.assertEqual(found["lists"], [True] * 4)
        self.assertEqual(found["async"], ["done", "done"])
        self.assertEqual(found["records"], [])

    def test_the_ten_lines_that_weigh_and_the_others_of_the_documentation(self):
        with service.Service("--bench", "simulated") as fresh:
            where = {"FLIP_URL": fresh.url, "FLIP_TOKEN": fresh.secrets[service.OPERATOR]}
            ten, both, table = snippets("Weigh")
            self.assertLessEqual(len(ten.splitlines()), 10)
            self.assertRegex(run(self.python, few_grains(ten), **where), r"^(within|under|over) \d+\.\d mg\n")
            self.assertIn("within", run(self.python, both, **where))
            self.assertIn("error_mg", run(self.python, table, **where))
            self.assertLessEqual(len(readme()[0].splitlines()), 10)
            self.assertRegex(run(self.python, few_grains(readme()[0]), **where), r"^(within|under|over) \d+\.\d")
            example = run(self.python, few_grains((ROOT / "python/examples/weigh.py").read_text()), **where)
            self.assertIn("reading_mg", example)


class Killed(unittest.TestCase):
    def test_a_client_outlives_a_service_that_is_killed_in_the_middle_of_a_dose(self):
        program = plain()
        with service.Service.ready() as flip:
            secret, port = flip.secrets[service.OPERATOR], flip.url.rpartition(":")[2]
            command = [program, str(service.HERE / "with_python_kill.py"), flip.url, secret, service.POWDER, "dose-1"]
            client = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
            self.assertEqual(client.stdout.readline().strip(), "moving")
            flip.kill()
            time.sleep(0.5)
            again(flip, port)
            said = client.communicate(timeout=120)[0].strip().splitlines()[-1]
        self.assertIn('"state": "unknown", "outcome": "unknown", "same": true, "weighings": 1', said)


def again(flip, port):
    """Starts a service again where it was."""
    command = [service.BINARY, "serve", "--json", "--listen", f"127.0.0.1:{port}", "--data-dir", str(flip.data)]
    flip.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=flip.log)


class Simulator(unittest.TestCase):
    def test_heaps_spoons_and_calibration_in_this_process(self):
        found = service.drive(plain(), "with_python_sim.py")
        self.assertEqual(len(found["parameters"]), 9)
        self.assertIn("humidity", found["extensions"])
        self.assertEqual(found["refused"], ["friction", "stickiness"])
        self.assertEqual(found["snapshot"], [True, 3, "float32", True])
        for name in ("no_angle", "wet_is_steeper", "lock_released"):
            self.assertTrue(found[name], name)
        for name in ("heaps", "spoon", "film", "step_all"):
            self.assertTrue(all(found[name]), (name, found[name]))
        self.assertEqual(found["sets"], [True, True, 0.65])
        self.assertEqual(found["calibrated"], [True, "ps-"])

    def test_the_documentation_simulates(self):
        (code,) = snippets("Simulate")
        self.assertIn("deg", run(plain(), code))


class Environment(unittest.TestCase):
    def test_gymnasium_finds_nothing_wrong_and_lockstep_is_the_same_as_alone(self):
        found = service.drive(plain(), "with_python_env.py")
        self.assertTrue(found["check_env"])
        self.assertEqual(found["vector"], "FlipWeighVectorEnv")
        self.assertEqual(found["lockstep"], [True, True])
        self.assertTrue(found["NextStep"])
        self.assertTrue(found["SameStep"])
        self.assertEqual(found["Disabled"], [True, [0.0, 10.0, 0.0], [True, False, True]])
        self.assertTrue(found["ended"])
        self.assertEqual(found["level"], [1.0, 4.0, 0.9])
        self.assertEqual(found["settings"], [0.3, "curriculum"])
        self.assertEqual(found["refused"], ["balance.readability_mg", "preset", "settings", "extensions", "levels", "levels[0].sets"])
        self.assertEqual(found["pickled_spec"], "paper")

    def test_the_lines_of_the_documentation_that_play_many_doses(self):
        self.assertIn("(1024, 6)", run(plain(), snippets("Train")[1]))


class Learners(unittest.TestCase):
    def test_stable_baselines_finds_nothing_wrong_and_its_actor_does_in_flip_what_it_does_there(self):
        program = learner()
        with tempfile.TemporaryDirectory() as folder:
            file = pathlib.Path(folder, "policy.safetensors")
            found = service.drive(program, "with_python_learners.py", file)
            self.assertEqual([found["check_env"], found["vec_env"]], [True, [True, True]])
            reading, target, pitch = found["asked"]
            seen = ["--reading-mg", reading, "--target-mg", target, "--pitch-deg", pitch, "--readability-mg", 0.1]
            action = service.flip("policy", "infer", "--file", file, *seen)
            for name, wanted in zip(("incline_change_deg", "shake_mm"), found["action"], strict=True):
                self.assertAlmostEqual(action[name], wanted, 4)

    def test_the_twenty_lines_that_train(self):
        code = snippets("Train")[0]
        self.assertLessEqual(len([line for line in code.splitlines() if line]), 20)
        self.assertRegex(run(learner(), swapped(code, "learn(400)", "learn(240)")), r"mean absolute error \d+\.\d+ mg")
        code = readme()[1]
        self.assertLessEqual(len(code.splitlines()), 20)
        self.assertRegex(run(learner(), swapped(code, "20_000", "160")), r"^\d+\.\d\d mg")

    def test_the_examples_train_and_the_policy_acts_in_flip(self):
        program = learner()
        with tempfile.TemporaryDirectory() as folder:
            file = pathlib.Path(folder, "policy.safetensors")
            said = run(program, str(ROOT / "python/examples/sb3_sac.py"), 160, file)
            name = re.search(r"policy (p-[0-9a-f]{16}), \d+ bytes", said)[1]
            asked = ["policy", "infer", "--file", file, "--reading-mg", 0, "--target-mg", 10, "--pitch-deg", 0]
            self.assertIn("shake_mm", str(service.flip(*asked)), name)
        self.assertRegex(run(program, str(ROOT / "python/examples/ppo.py"), 5120), r"5120 steps .* mg")


class Adapters(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.python = adapters()
        cls.service = service.Service.ready()
        cls.addClassCleanup(cls.service.stop)
        cls.secret = cls.service.secrets[service.OPERATOR]

    def drive(self, name):
        found = service.drive(self.python, f"with_python_{name}.py", self.service.url, self.secret, service.POWDER)
        print({key: found[key] for key in found if key in ("pylabrobot", "bluesky", "ophyd_async", "ivoryos", "mlflow")}, file=sys.stderr)
        return found

    def test_pylabrobot(self):
        found = self.drive("pylabrobot")
        self.assertEqual([found["states"], found["unknown"], found["serialized"]], [[True, True], ["powder"], [True, True]])
        self.assertEqual(len(set(found["vials"])), 2)

    def test_pylabrobot_reads_and_tares_the_balance_between_doses(self):
        with service.Service.ready("--bench", "emulated") as emulated:
            secret = emulated.secrets[service.OPERATOR]
            reserved = emulated.post("/v1/bench/reservation", {"owner": "scale", "seconds": 600})["id"]
            found = service.drive(self.python, "with_python_scale.py", "weigh", emulated.url, secret, service.POWDER, reserved)
            self.assertIn("setup", found["before_setup"])
            # The emulated balance carries an empty vial of 12 g between doses.
            self.assertAlmostEqual(found["vial_g"], 12.0, delta=0.1)
            for grams in found["tared_g"] + found["old_name_g"]:
                self.assertAlmostEqual(grams, 0.0, delta=0.002)
            # 12 g are beyond its zero range.
            self.assertEqual(found["zero_with_a_load"], "409 balance-failed")
            self.assertEqual(found["serialized"], [True, True, True])
            self.assertEqual(found["reserved"], ["409 bench-reserved"] * 2)
            self.assertEqual(found["record"][0], "bool")
            self.assertGreater(found["record"][1], 0.0)
            self.assertLess(found["age_s"], 30)
            self.assertTrue(found["later"])
            self.assertEqual(found["busy"], ["409 bench-busy"] * 3)
            emulated.kill()
            emulated.start()
            emulated.ask("DELETE", f"/v1/bench/reservation/{reserved}")
            found = service.drive(self.python, "with_python_scale.py", "refused", emulated.url, secret)
            # A latched bench shows what is on its balance, and changes nothing.
            self.assertAlmostEqual(found["read_g"], 12.0, delta=0.1)
            self.assertEqual(found["refused"], ["409 bench-latched"] * 2)
            self.assertEqual(found["client"], ["not refused", *["409 bench-latched"] * 2])
        found = service.drive(self.python, "with_python_scale.py", "refused", self.service.url, self.secret)
        self.assertIn("no balance", found["setup"])
        self.assertEqual(found["client"], ["409 no-balance"] * 3)

    def test_bluesky(self):
        found = self.drive("bluesky")
        self.assertEqual([found["protocols"], found["doses"], found["units"]], [[True] * 4, [True, True], "mg"])
        self.assertEqual([found["vial"], found["exit"]], ["V12", "success"])
        self.assertTrue(all(found["stopped"]), found["stopped"])
        self.service.post("/v1/bench/resume", {"by": "Ada"})

    def test_ivoryos(self):
        found = self.drive("ivoryos")
        self.assertEqual(found["methods"], ["angle_of_repose", "bench_state", "dose", "stop"])
        self.assertEqual([found["offers_powders"], found["dose"], found["angle"], found["state"]], [True, [True, True], True, "free"])
        self.assertEqual(found["refused"], [False, True])

    def test_mlflow(self):
        found = self.drive("mlflow")
        self.assertEqual(found["weighings"], [12.0, ["weighings.json"]])
        self.assertEqual([found["evaluation"], found["training"], found["policy"]], [True, [20, 19, "1", "p-"], [True]])

    def test_the_documentation(self):
        with service.Service("--bench", "simulated") as fresh:
            where = {"FLIP_URL": fresh.url, "FLIP_TOKEN": fresh.secrets[service.OPERATOR]}
            job = fresh.post("/v1/calibrations", {**service.CALIBRATION, "powder": "salt"})
            fresh.until(f"/v1/jobs/{job['id']}", lambda it: it["state"] not in ("queued", "running"))
            said = {}
            for heading in ("PyLabRobot", "Bluesky", "MLflow"):
                (code,) = snippets(heading)
                said[heading] = run(self.python, code, **where)
            self.assertIn("actual_amount", said["PyLabRobot"])
            self.assertEqual(len(re.findall(r"^event .*'doser-reading'", said["Bluesky"], re.M)), 2)
            self.assertRegex(said["MLflow"], r"^[0-9a-f]{32}\n$")


if __name__ == "__main__":
    unittest.main(verbosity=2)
