"""Reads lists of FLIP as an analyst does: `python with_tables.py URL`. Prints one JSON document."""

import io
import json
import sys
import urllib.request

import duckdb
import pandas
import polars

url = sys.argv[1]


def get(path):
    return urllib.request.urlopen(url + path, timeout=60).read()


arrow = get("/v1/weighings?format=arrow")
doses = pandas.read_feather(io.BytesIO(arrow))
frame = polars.read_ipc(io.BytesIO(arrow))
weighed = frame.to_arrow()
text = pandas.read_csv(io.BytesIO(get("/v1/weighings?format=csv")))
print(
    json.dumps(
        {
            "rows": [len(doses), len(frame), len(text)],
            "types": {name: str(doses[name].dtype) for name in ("target_mg", "shakes", "created_at", "measured.proven", "outcome")},
            "mean_mg": [float(doses.target_mg.mean()), frame["target_mg"].mean(), duckdb.sql("SELECT avg(target_mg) FROM weighed").fetchall()[0][0], float(text.target_mg.mean())],
            "powders": len(pandas.read_csv(io.BytesIO(get("/v1/powders?format=csv")))),
        }
    )
)
