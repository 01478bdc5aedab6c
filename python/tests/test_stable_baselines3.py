"""Stable-Baselines3, which needs torch: only if ``AIRCOMP_UAV_STABLE_BASELINES3`` is set, and then
it must be installed."""

from __future__ import annotations

import os
import warnings
from pathlib import Path

import numpy as np
import pytest

import aircomp_uav
from aircomp_uav import MissionEnv

pytestmark = pytest.mark.skipif(
    "AIRCOMP_UAV_STABLE_BASELINES3" not in os.environ,
    reason="AIRCOMP_UAV_STABLE_BASELINES3 is not set",
)


@pytest.mark.parametrize(
    ("observation", "action"),
    [("paper", "box"), ("flat", "box"), ("sets", "box"), ("paper", "discrete")],
)
def test_the_checker_has_nothing_to_say(observation: str, action: str) -> None:
    from stable_baselines3.common.env_checker import check_env

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        if observation == "sets":
            # The arrays of the dictionary are tables of users and sensors, as networks for sets take them.
            warnings.filterwarnings("ignore", message=".*unconventional shape")
        check_env(MissionEnv(observation=observation, action=action))


@pytest.mark.parametrize("algorithm", ["SAC", "PPO", "A2C"])
def test_a_few_steps_a_flight_and_an_export(algorithm: str, tmp_path: Path) -> None:
    import stable_baselines3

    settings = {"SAC": {"learning_starts": 60}, "PPO": {"n_steps": 60, "batch_size": 60}, "A2C": {}}
    kind = getattr(stable_baselines3, algorithm)
    model = kind("MlpPolicy", MissionEnv(), seed=1, device="cpu", **settings[algorithm])
    model.learn(200)
    flight = aircomp_uav.fly("separated", model)
    assert flight.arrived and flight.fair and flight.sum_rate > 0
    path = tmp_path / "policy.onnx"
    aircomp_uav.export_onnx(model, "separated", path)
    policy = aircomp_uav.load_policy(path)
    assert (policy.metadata["algorithm"], policy.metadata["seed"]) == (algorithm.lower(), "1")
    raw, normalized = MissionEnv(normalize=False), MissionEnv()
    (observation, _), (seen, _) = raw.reset(), normalized.reset()
    terminated = False
    while not terminated:
        action, _ = model.predict(seen, deterministic=True)
        displacement, scores = policy(observation)
        exported = np.concatenate([displacement / np.float32(raw.mission.reach_m), scores])
        np.testing.assert_allclose(exported, action, atol=1e-5)
        observation, _, terminated, _, _ = raw.step(action)
        seen, *_ = normalized.step(action)
    onboard = aircomp_uav.benchmark(path, "separated").missions["sum_rate"].item()
    assert abs(onboard - flight.sum_rate) <= 1e-4 * flight.sum_rate


def test_models_that_cannot_be_exported_are_named(tmp_path: Path) -> None:
    from stable_baselines3 import PPO, TD3
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    with pytest.raises(TypeError, match="model is a TD3"):
        aircomp_uav.export_onnx(TD3("MlpPolicy", MissionEnv()), "separated", tmp_path / "none.onnx")
    env = VecNormalize(DummyVecEnv([MissionEnv]))
    with pytest.raises(ValueError, match="VecNormalize"):
        aircomp_uav.export_onnx(PPO("MlpPolicy", env), "separated", tmp_path / "none.onnx")
    with pytest.raises(ValueError, match="use_sde"):
        model = PPO("MlpPolicy", MissionEnv(), use_sde=True)
        aircomp_uav.export_onnx(model, "separated", tmp_path / "none.onnx")
