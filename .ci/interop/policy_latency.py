"""onnxruntime's time for one decision, beside `cargo bench -p trainer --features onnx --bench plan`.

    python3 policy_latency.py POLICY.onnx
"""

import sys
import time

import numpy as np
import onnxruntime


def main() -> None:
    (path,) = sys.argv[1:]
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(path, options)
    (source,) = session.get_inputs()
    observation = np.full(source.shape, 2.0, dtype=np.float32)
    micros = []
    for _ in range(100_000):
        start = time.perf_counter()
        session.run(None, {"observation": observation})
        micros.append((time.perf_counter() - start) * 1e6)
    micros.sort()
    print(f"onnxruntime of {len(micros):,}: median {micros[50_000]:.1f} us, "
          f"99.9 % {micros[99_900]:.1f} us, worst {micros[-1]:.1f} us")


if __name__ == "__main__":
    main()
