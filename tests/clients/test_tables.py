"""Lists as tables, read by pandas, Polars and DuckDB."""

import unittest
import uuid

from service import POWDER, Service, drive, environment

ANALYST = ("analyst", "pandas==3.1.1", "pyarrow==26.0.1", "polars==2.1.0", "duckdb==2.0.1")


class Tables(unittest.TestCase):
    def test_doses_have_their_types_in_three_libraries(self):
        python = environment(*ANALYST)
        with Service.ready() as service:
            for target in (10, 12):
                dose = {"powder": POWDER, "target": {"value": target, "unit": "mg"}, "tolerance": {"lower": 3, "upper": 3, "unit": "mg"}}
                service.ended(service.post("/v1/weighings", dose, **{"Idempotency-Key": str(uuid.uuid4())})["id"])
            found = drive(python, "with_tables.py", service.url)
            self.assertEqual(found["rows"], [2, 2, 2])
            self.assertEqual(found["mean_mg"], [11.0] * 4)
            self.assertEqual(found["types"]["target_mg"], "float64")
            self.assertEqual(found["types"]["created_at"], "datetime64[ms, UTC]")
            self.assertGreaterEqual(found["powders"], 5)


if __name__ == "__main__":
    unittest.main()
