"""The SiLA 2 server, driven by three clients that others wrote."""

import json
import pathlib
import re
import socket
import subprocess
import tempfile
import unittest

from service import OPERATOR, ROOT, Service, drive, environment, skip

SILA2 = ("sila2", "sila2==0.14.0", "cryptography==50.0.2")
UNITELABS = ("unitelabs-sila", "unitelabs-sila==0.13.0")
MADSCI = ("madsci-sila", "madsci.client[sila]==0.8.1", "sila2==0.14.0", "pydantic<2.12")
PLAIN = ("--sila", "127.0.0.1:0", "--sila-insecure", "--sila-role", OPERATOR)
WEIGHING = "flip/weighing/PowderWeighing/v1"
# More than a spoon lets fall before somebody can cancel.
LARGE = 30


def defined(name, feature=WEIGHING):
    return f"{feature}/DefinedExecutionError/{name}"


class Simulated(unittest.TestCase):
    """A service with a simulated bench, shared by the tests of one client."""

    @classmethod
    def setUpClass(cls):
        cls.python = environment(*cls.PACKAGES)
        cls.service = Service.ready(*PLAIN)
        cls.addClassCleanup(cls.service.stop)

    def tearDown(self):
        # A stop holds the bench: the next test weighs.
        if self.service.get("/v1/bench")["held"]:
            self.service.post("/v1/bench/resume", {"by": "test"})

    def drive(self, what, *more):
        return drive(self.python, self.SCRIPT, what, *self.service.sila, *more)


class Sila2(Simulated):
    PACKAGES, SCRIPT = SILA2, "with_sila2.py"

    def test_the_server_says_who_it_is_and_what_it_can_do(self):
        found = self.drive("who")
        self.assertIn(WEIGHING, found["features"])
        self.assertIn("org.silastandard/core.commands/CancelController/v1", found["features"])
        self.assertNotIn("org.silastandard/core/LockController/v1", found["features"])
        self.assertEqual(found["type"], "PowderDoser")

    def test_a_dose_shows_its_mass_as_it_grows_and_ends_with_a_result(self):
        found = self.drive("dose", "sila2-dose")
        self.assertEqual((found["status"], found["progress"]), ("finishedSuccessfully", 1.0))
        masses = [mass for mass, _ in found["values"]]
        self.assertGreater(len(masses), 3)
        self.assertEqual(found["values"][-1][1], "done")
        self.assertEqual(masses[-1], found["value"]["Mass"])
        weighing = json.loads(found["value"]["Weighing"])
        self.assertEqual((weighing["id"], weighing["asked"]["lot"], weighing["asked"]["operator"]), (found["uuid"], "lot 7", "Ada"))
        # REST shows the same, and the audit trail names the token.
        self.assertEqual(self.service.get(f"/v1/weighings/{found['uuid']}")["weighing"]["outcome"], found["value"]["Outcome"])
        self.assertEqual(self.drive("bench")["reading"]["Weighing"], found["uuid"])
        self.assertIn("<html", self.drive("certificate", found["uuid"])["page"])

    def test_the_same_identifier_is_the_same_dose_and_with_other_parameters_an_error(self):
        first, again = (self.drive("attempt", "sila2-once")["value"] for _ in range(2))
        self.assertEqual(first, again)
        other = self.drive("attempt", "sila2-once", "16")["error"]
        self.assertEqual(other["identifier"], defined("DoseIdentifierReused"))
        self.service.ended(first)

    def test_a_dose_is_cancelled_and_says_so(self):
        found = self.drive("cancel", "sila2-cancelled", LARGE)
        self.assertEqual(found["status"], "finishedWithError")
        self.assertEqual(found["error"]["identifier"], defined("DoseStopped"))
        sentence, _, document = found["error"]["message"].partition("\n")
        self.assertIn("stopped", sentence)
        self.assertEqual(json.loads(document)["outcome"], "stopped")
        # A stop holds the bench until somebody resumes.
        self.assertEqual(found["bench"], "Held")
        self.assertEqual(self.drive("stop"), {"stopped": "Held", "resumed": "Idle"})

    def test_errors_have_the_kind_and_the_name_that_a_client_can_act_on(self):
        found = self.drive("errors")
        parameter = f"{WEIGHING}/Command/DosePowder/Parameter"
        self.assertEqual(found["powder"]["error"]["parameter"], f"{parameter}/Powder")
        self.assertEqual(found["key"]["error"]["parameter"], f"{parameter}/DoseIdentifier")
        self.assertEqual(found["target"]["error"]["identifier"], defined("TargetAboveCapacity"))
        self.assertEqual(found["uncalibrated"]["error"]["identifier"], defined("PowderNotCalibrated"))
        cancel = "org.silastandard/core.commands/CancelController/v1"
        self.assertEqual(found["cancel"]["error"]["identifier"], defined("InvalidCommandExecutionUUID", cancel))
        self.assertEqual(found["feature"]["error"]["kind"], "UnimplementedFeature")
        # Clearing is a right of its own, which an operator's token lacks.
        self.assertIn("right of its own", found["looked"]["error"]["message"])
        self.assertEqual(found["resume"]["error"]["identifier"], defined("BenchNotHeld", "flip/weighing/BenchControl/v1"))

    def test_a_calibration_is_an_execution_too(self):
        found = self.drive("calibrate")
        self.assertEqual((found["status"], found["progress"]), ("finishedSuccessfully", 1.0))
        self.assertGreater(found["sets"], 0)

    def test_a_simulated_bench_has_no_stand_for_piles(self):
        found = self.drive("measure")
        self.assertEqual(found["error"]["identifier"], defined("NoStand", "flip/flowability/AngleOfReposeMeasurement/v1"))

    def test_a_campaign_is_judged_and_a_large_one_travels_in_chunks(self):
        head = "powder,repose_deg,session,note\n"
        rows = [f"sand,{33 + (k % 7) * 0.2},{k % 5},{'x' * 9000}" for k in range(300)]
        with tempfile.TemporaryDirectory() as folder:
            small, large = pathlib.Path(folder, "small.csv"), pathlib.Path(folder, "large.csv")
            small.write_text(head + "\n".join(row.rstrip("x") for row in rows[:30]))
            large.write_text(head + "\n".join(rows))
            found = self.drive("investigate", small)
            self.assertIn("value", found, found)
            self.assertEqual(found["value"]["verdict"], found["value"]["report"])
            self.assertEqual(found["simulator"], "base")
            found = self.drive("investigate", large)
            # Whatever is thought of the rows, they arrived.
            self.assertTrue(found.get("value", {}).get("bytes", 0) > 2**21 or "Campaign" in found["error"].get("parameter", ""), found)


class Unitelabs(Simulated):
    PACKAGES, SCRIPT = UNITELABS, "with_unitelabs.py"

    def test_a_dose_shows_its_mass_and_ends_with_a_result(self):
        found = self.drive("dose", "unitelabs-dose")
        self.assertEqual(found["values"][-1][1], "done")
        self.assertIn(found["value"]["Outcome"], ("within", "under"))

    def test_a_dose_is_cancelled_and_says_so(self):
        found = self.drive("cancel", "unitelabs-cancelled", LARGE)
        self.assertEqual(found["error"]["kind"], "DoseStopped")

    def test_errors_have_the_kind_and_the_name_that_a_client_can_act_on(self):
        found = self.drive("errors")
        self.assertEqual(found["powder"]["error"]["parameter"], f"{WEIGHING}/Command/DosePowder/Parameter/Powder")
        self.assertEqual(found["target"]["error"]["kind"], "TargetAboveCapacity")


class Madsci(Simulated):
    PACKAGES, SCRIPT = MADSCI, "with_madsci_sila.py"

    def test_a_node_doses_and_shows_its_state(self):
        found = self.drive("dose", "madsci-dose")
        self.assertIn("PowderWeighing.DosePowder", found["actions"])
        self.assertEqual((found["begun"], found["busy"], found["status"]), ("running", True, "succeeded"))
        self.assertIn(found["result"]["Outcome"], ("within", "under"))
        self.assertEqual(found["state"]["BenchControl.State"], "Idle")
        # A structure of SiLA comes as a list of its elements.
        self.assertIn(found["result"]["Mass"], found["state"]["BalanceReading.Reading"])

    def test_a_dose_is_cancelled_and_says_so(self):
        found = self.drive("cancel", "madsci-cancelled", LARGE)
        self.assertEqual((found["cancel"]["status"], found["status"]), ("succeeded", "failed"))
        self.assertIn("DoseStopped", found["errors"][0]["message"])

    def test_an_error_says_what_to_do(self):
        found = self.drive("errors")
        self.assertEqual((found["powder"]["status"], found["target"]["status"]), ("failed", "failed"))
        self.assertIn("a lower-case letter", found["powder"]["errors"][0]["message"])
        self.assertIn("portions", found["target"]["errors"][0]["message"])


class Guarded(unittest.TestCase):
    def test_who_shows_no_token_may_only_read_and_a_log_in_gives_one(self):
        python = environment(*SILA2)
        with Service.ready("--sila", "127.0.0.1:0", "--sila-insecure") as service:
            found = drive(python, "with_sila2.py", "login", *service.sila, OPERATOR, service.secrets[OPERATOR])
        failed = defined("AuthenticationFailed", "org.silastandard/core/AuthenticationService/v1")
        self.assertEqual(found["wrong"]["error"]["identifier"], failed)
        self.assertEqual(found["before"]["error"]["kind"], "InvalidMetadata")
        self.assertIn(found["ended"]["value"]["Outcome"], ("within", "under"))
        invalid = defined("InvalidAccessToken", "org.silastandard/core/AuthorizationService/v1")
        self.assertEqual([found[when]["error"]["identifier"] for when in ("invalid", "after")], [invalid, invalid])
        self.assertIn(f"{WEIGHING}/Command/DosePowder", found["affected"])

    def test_a_server_that_may_be_locked_is_locked_for_every_other_client(self):
        python = environment(*SILA2)
        with Service.ready(*PLAIN, "--sila-lock") as service:
            found = drive(python, "with_sila2.py", "lock", *service.sila)
        lock = "org.silastandard/core/LockController/v1"
        self.assertEqual(found["twice"]["error"]["identifier"], defined("ServerAlreadyLocked", lock))
        self.assertIn("InvalidLockIdentifier", found["without"]["error"]["message"])
        self.assertIn(found["ended"]["value"]["Outcome"], ("within", "under"))
        self.assertEqual(found["wrong"]["error"]["identifier"], defined("InvalidLockIdentifier", lock))
        self.assertEqual((found["locked"], found["after"]), (True, False))

    def test_what_would_expose_the_bench_is_refused_by_the_name_of_the_option(self):
        def refused(*arguments):
            with self.assertRaises(RuntimeError) as caught:
                Service(*arguments).stop()
            return str(caught.exception)

        self.assertIn("sila_insecure", refused("--sila", "0.0.0.0:0", "--sila-insecure"))
        self.assertIn("sila_role", refused("--sila", "127.0.0.1:0", "--sila-insecure", "--sila-role", "nobody"))
        self.assertIn("admin", refused("--sila", "127.0.0.1:0", "--sila-insecure", "--sila-role", "admin"))


def own_address():
    """An address of this machine that others may reach."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))
            return probe.getsockname()[0]
        except OSError:
            skip("this machine has no network")


class Encrypted(unittest.TestCase):
    """A server that others can reach speaks TLS, with a certificate that it announces."""

    @classmethod
    def setUpClass(cls):
        cls.python = environment(*SILA2)
        address = own_address()
        if address.startswith("127."):
            skip("this machine has no network")
        cls.service = Service("--sila", f"{address}:0")
        cls.addClassCleanup(cls.service.stop)
        cls.certificate = cls.service.data / "sila/certificate.pem"
        cls.uuid = json.loads((cls.service.data / "sila/server.json").read_text())["uuid"]

    def test_the_certificate_of_the_data_folder_lets_a_client_in(self):
        found = drive(self.python, "with_sila2.py", "tls", *self.service.sila, self.certificate)
        self.assertEqual(found["uuid"], self.uuid)

    def test_the_key_is_readable_by_nobody_else(self):
        self.assertEqual((self.service.data / "sila/key.pem").stat().st_mode & 0o777, 0o600)

    def test_sila2_finds_the_server_on_the_network_and_connects(self):
        found = drive(self.python, "with_sila2.py", "discover", self.uuid, "0")
        self.assertEqual(found["uuid"], self.uuid)

    def test_unitelabs_finds_the_server_on_the_network_and_connects(self):
        python = environment(*UNITELABS)
        with self.assertRaises(AssertionError) as caught:
            # It connects, and reads only what nobody need be known for.
            drive(python, "with_unitelabs.py", "discover", self.uuid, "0")
        self.assertIn("AccessToken", str(caught.exception))


class Killed(unittest.TestCase):
    def test_an_execution_outlives_kill_9_in_the_middle_of_a_dose_and_nothing_is_poured_twice(self):
        python = environment(*SILA2)
        with Service.ready(*PLAIN, "--bench", "emulated") as service:
            begun = drive(python, "with_sila2.py", "begin", *service.sila, "killed-dose")
            service.kill()
            service.start()
            found = drive(python, "with_sila2.py", "look", *service.sila, begun["uuid"])
            self.assertEqual((found["status"], found["outcome"]), ("finishedWithError", "unknown"))
            self.assertEqual(found["error"]["identifier"], defined("DoseOutcomeUnknown"))
            self.assertEqual((found["bench"]["State"], found["bench"]["Kind"]), ("Latched", "emulated"))
            # The scheduler asks again with the same identifier: the same dose, and none is poured.
            self.assertEqual(drive(python, "with_sila2.py", "attempt", *service.sila, "killed-dose")["value"], begun["uuid"])
            latched = drive(python, "with_sila2.py", "attempt", *service.sila, "another-dose")["error"]
            self.assertEqual(latched["identifier"], defined("BenchLatched"))
            balance = drive(python, "with_sila2.py", "balance", *service.sila)
            self.assertIn("value", balance["Read"], "reading moves nothing")
            self.assertEqual(balance["Tare"]["error"]["identifier"], "flip/weighing/BalanceReading/v1/DefinedExecutionError/BenchLatched")
            self.assertEqual(service.get("/v1/weighings")["total"], 1)

    def test_an_emulated_bench_measures_an_angle_and_gives_its_frames(self):
        python = environment(*SILA2)
        with Service.ready(*PLAIN, "--bench", "emulated") as service:
            found = drive(python, "with_sila2.py", "measure", *service.sila)
            balance = drive(python, "with_sila2.py", "balance", *service.sila)
        self.assertIn("value", found, found)
        self.assertGreater(found["value"]["angle"], 10)
        self.assertGreater(found["value"]["frame"], 1000)
        # An empty vial of 12 g stands on it, beyond its zero range.
        self.assertAlmostEqual(balance["Read"]["value"]["Mass"], 12000, delta=20)
        self.assertAlmostEqual(balance["Tare"]["value"]["Mass"], 0, delta=3)
        self.assertTrue(balance["Tare"]["value"]["Stable"])
        self.assertEqual(balance["Zero"]["error"]["identifier"], "flip/weighing/BalanceReading/v1/DefinedExecutionError/BalanceFailed")
        self.assertAlmostEqual(balance["after"]["value"]["Mass"], 0, delta=3)


class Definitions(unittest.TestCase):
    def test_the_protos_are_what_the_definitions_say(self):
        """By the standard's own schema and style sheet, which sila2 contains."""
        python = environment(*SILA2)
        with tempfile.TemporaryDirectory() as folder:
            for file in (ROOT / "proto/sila").glob("*.sila.xml"):
                pathlib.Path(folder, file.name).write_bytes(file.read_bytes())
            done = subprocess.run([python, str(ROOT / "proto/sila/generate.py"), folder], capture_output=True, text=True)
            self.assertEqual(done.returncode, 0, done.stderr)
            made = sorted(pathlib.Path(folder).glob("*.proto"))
            self.assertEqual(len(made), 11)
            for file in made:
                self.assertEqual(file.read_text(), (ROOT / "proto/sila" / file.name).read_text(), f"{file.name}: run proto/sila/generate.py")

    def test_every_error_that_the_code_names_is_in_a_definition(self):
        known = {name for file in (ROOT / "proto/sila").glob("*.sila.xml") for name in re.findall(r"<Identifier>(\w+)</Identifier>", file.read_text())}
        for file in (ROOT / "src/api/sila").glob("*.rs"):
            text = file.read_text().split("#[cfg(test)]")[0]
            for pair in re.findall(r'\("[\w.-]+",\s*"([A-Z]\w+)"\)', text) + re.findall(r'defined\(\s*"([A-Z]\w+)"', text):
                self.assertIn(pair, known, f"{file.name}: {pair}")


if __name__ == "__main__":
    unittest.main()
