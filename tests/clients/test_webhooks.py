"""Webhooks, verified by the library that Standard Webhooks gives to receivers."""

import json
import subprocess
import unittest
import uuid

from service import HERE, POWDER, Service, environment

WEBHOOKS = ("standardwebhooks", "standardwebhooks==1.1.0")


class Webhooks(unittest.TestCase):
    def test_the_end_of_a_dose_is_told_and_verified(self):
        python = environment(*WEBHOOKS)
        with Service.ready() as service:
            command = [python, str(HERE / "with_standard_webhooks.py")]
            receiver = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
            self.addCleanup(receiver.kill)
            port = receiver.stdout.readline().strip()
            added = service.post("/v1/webhooks", {"url": f"http://127.0.0.1:{port}/flip"})
            dose = {"powder": POWDER, "target": {"value": 12, "unit": "mg"}, "tolerance": {"lower": 3, "upper": 3, "unit": "mg"}}
            weighing = service.post("/v1/weighings", dose, **{"Idempotency-Key": str(uuid.uuid4())})
            told, _ = receiver.communicate(added["secret"] + "\n", timeout=200)
            told = json.loads(told.strip().splitlines()[-1])
            self.assertEqual(told["message"]["type"], "weighing.ended")
            self.assertEqual(told["message"]["data"]["id"], weighing["id"])
            self.assertTrue(told["refused"], "a changed message is refused")


if __name__ == "__main__":
    unittest.main()
