"""Holds `host-sim solve` against slots that an independent conic solver solved.

usage: reference_slots.py HOST_SIM f64|f32
"""

import json
import pathlib
import subprocess
import sys

import numpy as np

HOST_SIM, PRECISION = sys.argv[1:]
# (rate, relative; MSE over the threshold, relative; powers over their bounds, relative)
RATE, MSE, POWER = {"f64": (1e-6, 1e-9, 0.0), "f32": (2e-4, 1e-5, 1e-7)}[PRECISION]

root = pathlib.Path(__file__).resolve().parents[2]
reference = root.parent / "shared" / "reference" / "inner_cases.jsonl"
if not reference.exists():
    sys.exit(f"{reference}: not there; it lies beside the project in shared/")
text = reference.read_text()
cases = [json.loads(line) for line in text.splitlines()]
solved = subprocess.run(
    [HOST_SIM, "solve", "--precision", PRECISION, reference],
    check=True, capture_output=True, text=True,
)
answers = [json.loads(line) for line in solved.stdout.splitlines()]
assert len(answers) == len(cases) > 0, (len(answers), len(cases))

worst_rate = worst_mse = 0.0
for number, (case, answer) in enumerate(zip(cases, answers), start=1):
    where = f"line {number}: {answer}"
    assert "error" not in answer, where
    assert answer["feasible"] == case["feasible"], where
    gains = np.array(case["sensor_gain"])
    b = np.array(answer["sensor_coefficients"])
    p, eta = answer["user_power"], answer["eta"]
    assert b.shape == gains.shape and (b >= 0).all(), where
    assert (b**2 <= case["sensor_power_max"] * (1 + POWER)).all(), where
    assert 0 <= p <= case["user_power_max"] * (1 + POWER), where
    # The MSE and the rate from the paper's formulas, not from what the solver says.
    y, q, noise = b * np.sqrt(gains), case["user_gain"] * p, case["noise_power"]
    mse = (((eta * y - 1) ** 2).sum() + eta**2 * (q + noise)) / len(gains) ** 2
    rate = np.log2(1 + q / ((y**2).sum() + noise))
    if not case["feasible"]:
        assert mse > case["mse_threshold"], where
        continue
    worst_mse = max(worst_mse, mse / case["mse_threshold"] - 1)
    for value in (rate, answer["rate"]):
        error = abs(value - case["rate"]) / max(case["rate"], 1e-12)
        worst_rate = max(worst_rate, error)

print(f"{len(cases)} slots in {PRECISION}: rate within {worst_rate:.1e} (limit {RATE:.0e}), "
      f"MSE over the threshold by at most {max(worst_mse, 0):.1e} (limit {MSE:.0e})")
assert worst_rate <= RATE
assert worst_mse <= MSE
