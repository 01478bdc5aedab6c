"""The environment of one episode."""

from __future__ import annotations

import warnings
from itertools import product

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import aircomp_uav
from aircomp_uav import Mission, MissionEnv, Random

ID = "aircomp_uav/Mission-v0"


@pytest.mark.parametrize(
    ("observation", "action"),
    list(product(("paper", "sets", "flat"), ("box", "hybrid", "discrete"))),
)
def test_gymnasiums_checker_has_nothing_to_say(observation: str, action: str) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        env = gymnasium.make(ID, observation=observation, action=action)
        check_env(env.unwrapped)
    assert [str(w.message) for w in caught] == []


def test_rendering_passes_the_checker() -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(gymnasium.make(ID, render_mode="rgb_array").unwrapped)
    assert [str(w.message) for w in caught] == []


def test_gymnasium_imports_the_package_that_an_id_names() -> None:
    import subprocess
    import sys

    program = f"import gymnasium; print(gymnasium.make('aircomp_uav:{ID}').observation_space.shape)"
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert run.stdout == "(19,)\n"


def fly(env: MissionEnv, seed: int = 0) -> dict[str, object]:
    env.reset(seed=seed)
    env.action_space.seed(seed)
    rates, terminated = 0.0, False
    while not terminated:
        _, reward, terminated, truncated, info = env.step(env.action_space.sample())
        assert not truncated
        expected = info["reward_rate"] + float(np.float32(1e-6)) * info["reward_trajectory"]
        assert reward == pytest.approx(expected, abs=1e-9)
        rates += info["rate"]
    assert info["sum_rate"] == rates
    return info


@pytest.mark.parametrize("action", ["box", "hybrid", "discrete"])
def test_the_shield_makes_every_episode_arrive_and_fair(action: str) -> None:
    for seed in range(20):
        info = fly(MissionEnv(scenario=Random(seed), action=action), seed)
        assert info["arrived"] and info["fair"]
        assert info["interventions"] > 0


def test_penalties_allow_what_the_shield_forbids() -> None:
    env = MissionEnv(constraints="penalty", action="discrete")
    env.reset()
    for _ in range(60):
        assert env.action_masks().all()
        _, _, terminated, _, info = env.step(15 * 5 + 3)
    assert terminated and not info["arrived"] and not info["fair"]


def test_masked_actions_are_served_as_they_are() -> None:
    env = MissionEnv(action="discrete", directions=4)
    rng = np.random.default_rng(3)
    env.reset()
    masks = []
    terminated = False
    while not terminated:
        mask = env.action_masks()
        assert mask.shape == (5 * 15,)
        masks.append(mask.mean())
        action = rng.choice(np.flatnonzero(mask))
        _, _, terminated, _, info = env.step(action)
        assert info["user"] == action % 15
    assert min(masks) < 1 == max(masks)


def test_directions_are_counterclockwise_from_the_east() -> None:
    for direction, (east, north) in enumerate([(0, 0), (1, 0), (0, 1), (-1, 0), (0, -1)]):
        tables = {"start_m": [500.0, 500.0], "destination_m": [500.0, 500.0]}
        env = MissionEnv(scenario=with_mission(tables), action="discrete", directions=4)
        env.reset()
        env.step(direction * 15)
        np.testing.assert_allclose(env.position_m, (500 + 30 * east, 500 + 30 * north), atol=1e-4)


def with_mission(tables: dict[str, object]) -> dict[str, object]:
    tomllib = pytest.importorskip("tomllib")  # Python 3.11

    scenario = tomllib.loads(Mission.shipped("separated").to_toml())
    scenario["mission"].update(tables)
    return scenario


def test_bound_and_regret_are_in_the_last_info() -> None:
    env = MissionEnv(bound=0.05)
    info = fly(env)
    assert info["bound"] > info["sum_rate"] > 0
    assert info["regret"] == info["bound"] - info["sum_rate"]
    assert info["share"] == info["sum_rate"] / info["bound"]
    # The certified optimum of the default mission is between 61.83 and 62.10.
    assert 61.83 < info["bound"] < 66
    assert "bound" not in fly(MissionEnv())


def test_several_missions_take_turns() -> None:
    env = MissionEnv(scenario=Random(0, count=5), observation="flat")
    names = set()
    for seed in range(30):
        observation, _ = env.reset(seed=seed)
        assert observation in env.observation_space
        names.add(env.mission.name)
    assert len(names) == 5
    again = [(env.reset(seed=seed), env.mission.name)[1] for seed in (7, 8, 7)]
    assert again[0] == again[2]


def test_observations_are_those_of_the_contract() -> None:
    env = MissionEnv(observation="sets", action="hybrid")
    observation, _ = env.reset()
    mission = env.mission
    assert observation["user_mask"].sum() == mission.users
    assert observation["sensor_mask"].sum() == mission.sensors
    start = np.array(mission.start_m)
    np.testing.assert_allclose(
        observation["users"][: mission.users, :2], mission.user_positions_m - start, rtol=1e-6
    )
    raw = MissionEnv(normalize=False)
    raw.reset()
    observation, _, _, _, info = raw.step([0.1, 0.2] + [0] * 14 + [1])
    assert observation[14] == 1 and observation[:14].sum() == 0
    assert observation[15] == np.float32(info["rate"])
    np.testing.assert_allclose(observation[17:], raw.position_m, rtol=1e-6)


def test_a_step_after_the_end_is_an_error() -> None:
    env = MissionEnv()
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros(17))
    fly(env)
    with pytest.raises(ValueError, match="is over, and must be reset"):
        env.step(np.zeros(17))


def test_the_map_is_an_image() -> None:
    env = MissionEnv(render_mode="rgb_array")
    env.reset()
    before = env.render()
    env.step(np.ones(17))
    after = env.render()
    assert before is not None and after is not None
    assert before.shape == after.shape == (480, 480, 3) and before.dtype == np.uint8
    assert 0 < (before != after).any(axis=2).sum() < 1000
    human = MissionEnv(render_mode="human")
    human.reset()
    human.step(np.ones(17))
    assert human.render() is None


def test_the_version_is_that_of_the_workspace() -> None:
    assert aircomp_uav.__version__ == "0.1.0"
