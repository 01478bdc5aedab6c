"""Checks a policy for any mission with tools that are not ours.

    python3 any_policy_check.py TRAINER POLICY.onnx

TRAINER is the built `trainer` program. onnx.checker must accept the file, and tract and
onnxruntime must agree with the network that flies on a microcontroller within 1e-5 of full scale on
10,000 states.
Then onnxruntime alone shows what the contract promises: permuted users permute their scores,
permuted sensors change nothing, and rows beyond the masks have no effect.
"""

import json
import subprocess
import sys

import numpy as np
import onnx
import onnxruntime

STATES = 10_000
USERS, SENSORS = 16, 64
TOLERANCE = 1e-5


def padded(rows, count):
    """The rows as an input of the graph, and their mask."""
    rows = np.array(rows, dtype=np.float32)
    values = np.zeros((1, count, rows.shape[1]), dtype=np.float32)
    values[0, : len(rows)] = rows
    mask = (np.arange(count) < len(rows)).astype(np.float32)
    return values, mask[np.newaxis]


def inputs_of(state):
    users, user_mask = padded(state["users"], USERS)
    sensors, sensor_mask = padded(state["sensors"], SENSORS)
    return {
        "mission": np.array([state["mission"]], dtype=np.float32),
        "users": users, "user_mask": user_mask,
        "sensors": sensors, "sensor_mask": sensor_mask,
    }


def error(got, expected, full_scale) -> float:
    worst = float(np.abs(np.asarray(got) - np.asarray(expected)).max()) / full_scale
    # A NaN is no agreement; max() would pass over it.
    return worst if np.isfinite(worst) else np.inf


def main() -> None:
    trainer, path = sys.argv[1:]
    model = onnx.load(path)
    onnx.checker.check_model(model, full_check=True)
    metadata = {entry.key: entry.value for entry in model.metadata_props}
    names = metadata["mission_names"].split(",")
    # With --tract it fails where tract does not agree.
    probe = subprocess.run([trainer, "probe", path, "--tract", "--count", str(STATES)], check=True,
                           stdout=subprocess.PIPE, text=True)
    states = [json.loads(line) for line in probe.stdout.splitlines()]
    if len(states) != STATES:
        sys.exit(f"{path}: {len(states)} states of {STATES}")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(path, options)

    def run(inputs):
        displacement, scores = session.run(["displacement", "user_scores"], inputs)
        return displacement[0], scores[0]

    random = np.random.default_rng(1)
    worst = {"displacement": 0.0, "user_scores": 0.0, "reordered": 0.0, "padded": 0.0}

    def note(what, got, expected, full_scale):
        worst[what] = max(worst[what], error(got, expected, full_scale))

    scale = max(1.0, max(abs(score) for state in states for score in state["user_scores"]))
    for index, state in enumerate(states):
        reach_m = state["mission"][names.index("reach_m")]
        inputs = inputs_of(state)
        displacement, scores = run(inputs)
        note("displacement", displacement, state["displacement"], reach_m)
        note("user_scores", scores, state["user_scores"], scale)
        if index % (STATES // 100):
            continue
        users = random.permutation(len(state["users"]))
        sensors = random.permutation(len(state["sensors"]))
        reordered = inputs_of({**state, "users": [state["users"][i] for i in users],
                               "sensors": [state["sensors"][i] for i in sensors]})
        moved, permuted = run(reordered)
        note("reordered", moved, displacement, reach_m)
        note("reordered", permuted[: len(users)], scores[users], scale)
        disturbed = {name: value.copy() for name, value in inputs.items()}
        disturbed["users"][0, len(users):] = random.normal(size=(USERS - len(users), 1)) * 100
        disturbed["sensors"][0, len(sensors):] = random.normal(size=(SENSORS - len(sensors), 1)) * 100
        moved, padding = run(disturbed)
        note("padded", moved, displacement, reach_m)
        note("padded", padding, scores, scale)
    print(f"{path}: onnx.checker ok; {STATES} states; tract agrees; largest difference "
          + ", ".join(f"{what} {value:.1e}" for what, value in worst.items()) + " of full scale")
    wrong = [what for what, value in worst.items() if value > TOLERANCE]
    if wrong:
        sys.exit(f"{path}: too large: {', '.join(wrong)}")


if __name__ == "__main__":
    main()
