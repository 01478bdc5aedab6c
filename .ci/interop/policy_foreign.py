"""Writes a policy to the contract without any of our code, as another trainer would.

    python3 policy_foreign.py OUT.onnx

Operator set 13, MatMul and Add, one output layer cut by Slice, float_data instead of raw bytes:
everything that our own writer does not do. Random weights, for the default scenario's 15 users.
"""

import sys

import numpy as np
import onnx
from contract import FULL_SCALE, REACH_M, SEED, USERS, WIDTH, describe
from onnx import TensorProto, helper


def main() -> None:
    (path,) = sys.argv[1:]
    rng = np.random.default_rng(SEED)
    n = USERS + 4
    full_scale = np.array(FULL_SCALE)
    sizes = [n, WIDTH, WIDTH, 2 + USERS]
    weights = [rng.normal(0, 1 / np.sqrt(i), (i, o)) for i, o in zip(sizes, sizes[1:])]
    biases = [rng.normal(0, 0.1, o) for o in sizes[1:]]

    constants, nodes = [], []

    def constant(name: str, values) -> str:
        values = np.asarray(values)
        kind = TensorProto.INT64 if values.dtype == np.int64 else TensorProto.FLOAT
        constants.append(helper.make_tensor(name, kind, values.shape, values.flatten().tolist()))
        return name

    def node(op: str, inputs: list[str], output: str) -> str:
        nodes.append(helper.make_node(op, inputs, [output]))
        return output

    x = node("Div", ["observation", constant("half", full_scale / 2)], "divided")
    x = node("Add", [x, constant("minus_one", np.array([-1.0]))], "normalised")
    for i, (w, b) in enumerate(zip(weights, biases)):
        x = node("MatMul", [x, constant(f"w{i}", w)], f"product{i}")
        x = node("Add", [constant(f"b{i}", b), x], f"sum{i}")
        if i + 1 < len(weights):
            x = node("Relu", [x], f"relu{i}")

    def columns(name: str, start: int, end: int) -> str:
        bounds = [constant(f"{name}_{what}", np.array([value], dtype=np.int64))
                  for what, value in (("start", start), ("end", end), ("axis", 1))]
        return node("Slice", [x, *bounds], name)

    node("Mul", [node("Tanh", [columns("u", 0, 2)], "unit"),
                 constant("reach", np.array(REACH_M))], "displacement")
    columns("user_scores", 2, 2 + USERS)

    observation = full_scale * rng.uniform(0, 1, n)
    hidden = observation.astype(np.float32) / (full_scale / 2) - 1
    for i, (w, b) in enumerate(zip(weights, biases)):
        hidden = hidden @ w + b
        if i + 1 < len(weights):
            hidden = np.maximum(hidden, 0)
    graph = helper.make_graph(
        nodes, "foreign",
        [helper.make_tensor_value_info("observation", TensorProto.FLOAT, [1, n])],
        [helper.make_tensor_value_info("displacement", TensorProto.FLOAT, [1, 2]),
         helper.make_tensor_value_info("user_scores", TensorProto.FLOAT, [1, USERS])],
        constants,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    describe(model, observation, REACH_M * np.tanh(hidden[:2]), hidden[2:])
    onnx.checker.check_model(model, full_check=True)
    onnx.save(model, path)


if __name__ == "__main__":
    main()
