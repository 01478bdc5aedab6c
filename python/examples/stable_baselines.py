"""Trains SAC or PPO of Stable-Baselines3 and exports the policy.

    pip install stable-baselines3 onnxruntime
    python python/examples/stable_baselines.py ppo --steps 60000 --out ppo.onnx
    host-sim run --policy ppo.onnx

One line of JSON says how long it took, what the deterministic policy reaches in the environment, and
the largest difference between the actions of `predict` and of the exported file, as onnxruntime
evaluates it, over 20 episodes.
"""

from __future__ import annotations

import argparse
import json
import time
from typing import Any

import numpy as np
import stable_baselines3
import torch

import aircomp_uav


def largest_difference(model: Any, scenario: str, path: str) -> float:
    """Return the largest difference between the actions of a model and of its file."""
    policy = aircomp_uav.load_policy(path)
    raw = aircomp_uav.MissionEnv(scenario, normalize=False)
    normalized = aircomp_uav.MissionEnv(scenario)
    reach_m = np.float32(raw.mission.reach_m)
    rng = np.random.default_rng(1)
    largest = 0.0
    for episode in range(20):
        (observation, _), (seen, _) = raw.reset(), normalized.reset()
        terminated = False
        while not terminated:
            action, _ = model.predict(seen, deterministic=True)
            displacement, scores = policy(observation)
            exported = np.concatenate([displacement / reach_m, scores])
            largest = max(largest, float(np.abs(exported - action).max()))
            if episode > 0:
                # Anywhere, not only where the policy would fly.
                action = rng.uniform(-1, 1, action.shape).astype(np.float32)
            observation, _, terminated, _, _ = raw.step(action)
            seen, *_ = normalized.step(action)
    return largest


def main() -> None:
    """Train, export, and compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("algorithm", choices=["sac", "ppo"])
    parser.add_argument("--scenario", default="separated", help="name or file of the mission")
    parser.add_argument("--steps", type=int, default=60_000, help="slots to train for")
    parser.add_argument("--out", required=True, help="the file to write")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    env = aircomp_uav.MissionEnv(arguments.scenario)
    common: dict[str, Any] = {"seed": arguments.seed, "device": "cpu"}
    if arguments.algorithm == "sac":
        model: Any = stable_baselines3.SAC(
            "MlpPolicy", env, learning_starts=600, policy_kwargs={"net_arch": [128, 128]}, **common
        )
    else:
        model = stable_baselines3.PPO("MlpPolicy", env, n_steps=1200, batch_size=120, **common)
    begun = time.monotonic()
    model.learn(arguments.steps)
    seconds = time.monotonic() - begun
    episodes = arguments.steps // env.mission.slots
    aircomp_uav.export_onnx(model, arguments.scenario, arguments.out, episodes=episodes)
    flight = aircomp_uav.fly(arguments.scenario, model)
    result = {
        "algorithm": arguments.algorithm,
        "steps": arguments.steps,
        "seconds": round(seconds, 1),
        "sum_rate": flight.sum_rate,
        "largest_difference": largest_difference(model, arguments.scenario, arguments.out),
    }
    print(json.dumps(result))


if __name__ == "__main__":
    main()
