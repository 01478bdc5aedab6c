"""What every policy file says of itself (docs/training.md), for the scripts that write one without
our code: random weights, for the default scenario's 15 users."""

import numpy as np
from onnx import helper

USERS, WIDTH, REACH_M = 15, 64, 30.0
FULL_SCALE = [4.0] * USERS + [1.12, 0.015, 1000.0, 1000.0]
SEED = 5


def describe(model, observation, displacement, user_scores) -> None:
    """Puts the metadata with this test vector into the model."""

    def listed(values) -> str:
        return ",".join(str(float(v)) for v in np.asarray(values, dtype=np.float32).flatten())

    helper.set_model_props(model, {
        "format_version": "1",
        "users": str(USERS),
        "max_speed_mps": "30",
        "slot_duration_s": "1",
        "area_m": "1000,1000",
        "observation_names": ",".join([f"count_{m}" for m in range(USERS)]
                                      + ["rate", "mse", "east_m", "north_m"]),
        "algorithm": "random",
        "scenario": "none",
        "scenario_digest": "",
        "episodes": "0",
        "seed": str(SEED),
        "test_observation": listed(observation),
        "test_displacement": listed(displacement),
        "test_user_scores": listed(user_scores),
    })
