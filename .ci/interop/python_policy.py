"""From Python to the vehicle: a policy that is trained and exported in Python flies in `host-sim run`,
as the .onnx file and converted to the file of the microcontroller, with the sum of rates that the
Python environment had.

    python3 python_policy.py TARGET_DIRECTORY OUT_DIRECTORY

needs the package aircomp_uav and onnxruntime.
"""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np

import aircomp_uav

EXAMPLE = Path(__file__).resolve().parents[2] / "python/examples/evolution.py"
# Positions pass through MAVLink messages in single precision, and networks are evaluated in it.
TOLERANCE = 1e-5


def main() -> None:
    target, out = Path(sys.argv[1]), Path(sys.argv[2])
    out.mkdir(parents=True, exist_ok=True)
    onnx, policy = out / "evolved.onnx", out / "evolved.policy"
    command = [sys.executable, str(EXAMPLE), "--out", str(onnx)]
    trained = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    print(f"environment: {trained['sum_rate']:.6f} bit/s/Hz after {trained['episodes']} episodes, "
          f"straight line {trained['straight_line']:.6f}")
    assert trained["sum_rate"] > 1.05 * trained["straight_line"], "no better than the straight line"
    subprocess.run([target / "trainer", "convert", onnx, policy], check=True)
    for file in (onnx, policy):
        run = out / file.suffix[1:]
        subprocess.run([target / "host-sim", "run", "--policy", file, "--out", run],
                       check=True, stdout=subprocess.DEVNULL)
        summary = json.loads((run / "summary.json").read_text())
        print(f"host-sim run --policy {file.name}: {summary['sum_rate']:.6f} bit/s/Hz")
        assert np.isclose(summary["sum_rate"], trained["sum_rate"], rtol=TOLERANCE), file
        assert summary["arrived"] and summary["fair"], file
        assert summary["constraint_violations"] == 0, file
    # onnxruntime, in the environment.
    flight = aircomp_uav.fly("separated", aircomp_uav.load_policy(onnx))
    print(f"onnxruntime in the environment: {flight.sum_rate:.6f} bit/s/Hz")
    assert np.isclose(flight.sum_rate, trained["sum_rate"], rtol=TOLERANCE)


if __name__ == "__main__":
    main()
