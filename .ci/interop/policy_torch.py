"""Writes a policy to the contract with PyTorch's exporter, as whoever trains with PyTorch would.

    policy_torch.py OUT.onnx [--legacy]

Two heads, so two Gemm at the end. Random weights, for the default scenario's 15 users. Needs torch
and onnxscript; --legacy takes the exporter from before PyTorch 2.9. Not part of the default CI:
PyPI's torch is 3 GB.
"""

import sys

import onnx
import torch
from torch import nn

USERS, WIDTH, REACH_M = 15, 64, 30.0
FULL_SCALE = [4.0] * USERS + [1.12, 0.015, 1000.0, 1000.0]


class Policy(nn.Module):
    def __init__(self):
        super().__init__()
        self.register_buffer("half_scale", torch.tensor(FULL_SCALE) / 2)
        self.body = nn.Sequential(nn.Linear(USERS + 4, WIDTH), nn.ReLU(),
                                  nn.Linear(WIDTH, WIDTH), nn.ReLU())
        self.mean = nn.Linear(WIDTH, 2)
        self.scores = nn.Linear(WIDTH, USERS)

    def forward(self, observation):
        hidden = self.body(observation / self.half_scale - 1.0)
        return REACH_M * torch.tanh(self.mean(hidden)), self.scores(hidden)


def main() -> None:
    path, *legacy = sys.argv[1:]
    torch.manual_seed(5)
    policy = Policy().eval()
    observation = torch.rand(1, USERS + 4) * torch.tensor(FULL_SCALE)
    with torch.no_grad():
        displacement, user_scores = policy(observation)
    how = {"dynamo": False} if legacy else {"dynamo": True, "external_data": False}
    torch.onnx.export(policy, (observation,), path, input_names=["observation"],
                      output_names=["displacement", "user_scores"], opset_version=17, **how)

    def listed(values) -> str:
        return ",".join(str(float(v)) for v in values.flatten())

    model = onnx.load(path)
    onnx.helper.set_model_props(model, {
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
        "seed": "5",
        "test_observation": listed(observation),
        "test_displacement": listed(displacement),
        "test_user_scores": listed(user_scores),
    })
    onnx.save(model, path)


if __name__ == "__main__":
    main()
