"""pandas reads a run's slots.csv, and its sums are those of summary.json.

usage: slots_table.py RUN_FOLDER
"""

import json
import pathlib
import sys

import numpy as np
import pandas

folder = pathlib.Path(sys.argv[1])
slots = pandas.read_csv(folder / "slots.csv")
summary = json.loads((folder / "summary.json").read_text())
print(slots.describe().T.to_string())
assert len(slots) == summary["slots"]
assert not slots.select_dtypes("number").isna().any().any()
assert np.isclose(slots["rate_bit_s_hz"].sum(), summary["sum_rate"], rtol=1e-12)
assert (slots["slot"] == np.arange(1, len(slots) + 1)).all()
served = slots.groupby("served_user")["rate_bit_s_hz"].agg(["size", "sum"])
for user, row in served.iterrows():
    assert summary["users"][user]["slots"] == row["size"], user
    assert np.isclose(summary["users"][user]["data"], row["sum"]), user
assert summary["arrived"] and summary["fair"], summary
assert summary["mse_violations"] == 0 and summary["constraint_violations"] == 0, summary
