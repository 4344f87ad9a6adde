"""Weighs a dose: `FLIP_URL=http://127.0.0.1:8080 FLIP_TOKEN=flip_… python weigh.py`."""

from flip_powder import Client

with Client() as flip:
    flip.calibrate("salt", method="sequential", sets=2)
    dose = flip.weigh("salt", "15 mg", tolerance="1 mg", vial="A1", operator="Ada")
    print(dose.outcome, dose.reading_mg, "mg")
    if dose.measured:
        print("+-", dose.measured.uncertainty_mg, "mg (k = 2)")
    print(flip.weighings(powder="salt").to_pandas()[["id", "target_mg", "reading_mg", "outcome"]])
