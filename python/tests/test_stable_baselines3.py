"""Stable-Baselines3, which needs torch: only if ``AIRCOMP_UAV_STABLE_BASELINES3`` is set, and then
it must be installed."""

from __future__ import annotations

import os
import warnings

import pytest

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
        check_env(MissionEnv(observation=observation, action=action))


def test_a_few_steps_of_sac_and_a_flight() -> None:
    from stable_baselines3 import SAC

    import aircomp_uav

    model = SAC("MlpPolicy", MissionEnv(), learning_starts=60, seed=1, device="cpu")
    model.learn(200)
    flight = aircomp_uav.fly("separated", model)
    assert flight.arrived and flight.fair and flight.sum_rate > 0
