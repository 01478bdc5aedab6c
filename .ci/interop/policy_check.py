"""Checks an exported policy with tools that are not ours.

    python3 policy_check.py TRAINER POLICY.onnx

TRAINER is the built `trainer` program. onnx.checker must accept the file, and onnxruntime must
agree with our own forward pass within 1e-5 of full scale on 10,000 observations.
"""

import json
import subprocess
import sys

import numpy as np
import onnx
import onnxruntime


def main() -> None:
    trainer, path = sys.argv[1:]
    model = onnx.load(path)
    onnx.checker.check_model(model, full_check=True)
    metadata = {entry.key: entry.value for entry in model.metadata_props}
    reach_m = float(metadata["max_speed_mps"]) * float(metadata["slot_duration_s"])

    probe = subprocess.run([trainer, "probe", path], check=True, capture_output=True, text=True)
    lines = [json.loads(line) for line in probe.stdout.splitlines()]
    if len(lines) != 10_000:
        sys.exit(f"{path}: {len(lines)} observations of 10,000")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(path, options)
    scores = np.array([line["user_scores"] for line in lines])
    full_scale = {"displacement": reach_m, "user_scores": max(1.0, float(np.abs(scores).max()))}
    worst = {"displacement": 0.0, "user_scores": 0.0}
    for line in lines:
        observation = np.array([line["observation"]], dtype=np.float32)
        outputs = session.run(["displacement", "user_scores"], {"observation": observation})
        for name, output in zip(worst, outputs):
            error = np.abs(output[0] - np.array(line[name], dtype=np.float32)).max()
            # A NaN is no agreement; max() would pass over it.
            error = float(error) / full_scale[name]
            worst[name] = max(worst[name], error if np.isfinite(error) else np.inf)
    print(f"{path}: onnx.checker ok; {len(lines)} observations; largest difference "
          + ", ".join(f"{name} {error:.1e}" for name, error in worst.items()) + " of full scale")
    if max(worst.values()) > 1e-5:
        sys.exit(1)


if __name__ == "__main__":
    main()
