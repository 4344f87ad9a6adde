"""The MADSci node, driven by MADSci's own client of nodes and by its workcell engine."""

import unittest

from service import OPERATOR, Service, drive, environment

MADSCI = ("madsci", "madsci.client==0.8.1", "madsci.workcell_manager==0.8.1", "pydantic<2.12")


class Node(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.python = environment(*MADSCI)
        cls.service = Service.ready("--bench", "simulated")
        cls.addClassCleanup(cls.service.stop)
        # HTTP Basic is all that MADSci sends, and the address is where it has it from.
        token = cls.service.secrets[OPERATOR]
        cls.node = cls.service.url.replace("http://", f"http://workcell:{token}@") + "/madsci"

    def test_the_client_of_nodes_doses_stops_and_is_told_what_is_wrong(self):
        found = drive(self.python, "with_madsci_node.py", self.node)
        self.assertEqual(found["actions"], ["calibrate", "clear_latch", "dose_powder", "measure_repose"])
        self.assertTrue(found["ready"])
        self.assertEqual(found["state"], ["bench"])
        self.assertEqual(found["dose"], {"status": "succeeded", "powder": "sand", "outcome": "within"})
        self.assertEqual(sorted(found["files"]), ["certificate", "trace"])
        self.assertTrue(found["files"]["trace"].startswith("step,t_s,"))
        self.assertEqual(found["history"], "succeeded")
        self.assertEqual(found["started_twice"][0], True, "one weighing")
        self.assertTrue(found["busy"] and found["safety_stop"])
        self.assertEqual(found["stopped"], "cancelled")
        self.assertTrue(found["held"] and found["resume"] and found["ready_again"])
        status, kind, message = found["unknown_powder"]
        self.assertEqual((status, kind), ("failed", "invalid"))
        self.assertIn("unobtainium", message)
        self.assertEqual(found["unknown_argument"], [400, "target_gm"])
        self.assertTrue(found["lock"] and found["locked"] and found["unlock"])
        self.assertIn("serves others", found["shutdown"])
        self.assertTrue(found["log"])
        self.assertEqual(self.service.get("/v1/weighings?vial=A2")["total"], 1, "poured once")

    def test_the_engine_runs_a_workflow_of_two_doses(self):
        found = drive(self.python, "with_madsci_engine.py", self.node)
        self.assertEqual(found["steps"], ["succeeded", "succeeded"], found)
        self.assertTrue(found["completed"])
        doses = {dose["asked"]["vial"]: dose["outcome"] for dose in self.service.get("/v1/weighings?sort=newest&limit=2")["items"]}
        self.assertEqual(doses, {"B1": "within", "B2": "within"})


if __name__ == "__main__":
    unittest.main()
