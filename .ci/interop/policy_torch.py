"""Writes a policy to the contract with PyTorch's exporter, as whoever trains with PyTorch would.

    policy_torch.py OUT.onnx [--legacy]

Two heads, so two Gemm at the end. Random weights, for the default scenario's 15 users. Needs torch
and onnxscript; --legacy takes the exporter from before PyTorch 2.9. Not part of the default CI:
PyPI's torch is 3 GB.
"""

import sys

import onnx
import torch
from contract import FULL_SCALE, REACH_M, SEED, USERS, WIDTH, describe
from torch import nn


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
    torch.manual_seed(SEED)
    policy = Policy().eval()
    observation = torch.rand(1, USERS + 4) * torch.tensor(FULL_SCALE)
    with torch.no_grad():
        displacement, user_scores = policy(observation)
    how = {"dynamo": False} if legacy else {"dynamo": True, "external_data": False}
    torch.onnx.export(policy, (observation,), path, input_names=["observation"],
                      output_names=["displacement", "user_scores"], opset_version=17, **how)
    model = onnx.load(path)
    describe(model, observation, displacement, user_scores)
    onnx.save(model, path)


if __name__ == "__main__":
    main()
