"""The vectorized environment, compared with Gymnasium's own around single environments."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.vector.utils import iterate

from aircomp_uav import MissionEnv, MissionVectorEnv, Random

MODES = list(AutoresetMode)


def assert_same(ours: Any, theirs: Any) -> None:
    if isinstance(theirs, dict):
        assert set(ours) == set(theirs)
        for key in theirs:
            assert_same(ours[key], theirs[key])
    elif isinstance(theirs, np.ndarray) and theirs.dtype == object:
        assert ours.shape == theirs.shape and ours.dtype == object
        for one, other in zip(ours, theirs, strict=True):
            assert_same(one, other)
    elif isinstance(theirs, np.ndarray):
        np.testing.assert_array_equal(ours, theirs)
        assert ours.dtype == theirs.dtype or theirs.dtype.kind in "iu"
    else:
        assert ours == theirs


def assert_same_infos(ours: dict[str, Any], theirs: dict[str, Any]) -> None:
    """Compare infos where their masks say that there is something."""
    for key in set(ours) ^ set(theirs):
        # What nobody has may be there, with a mask that says so.
        assert key in ours and not ours[key if key.startswith("_") else f"_{key}"].any(), key
    for key, values in theirs.items():
        if key.startswith("_"):
            np.testing.assert_array_equal(ours[key], values, err_msg=key)
        elif isinstance(values, dict):
            assert_same_infos(ours[key], values)
        else:
            mask = theirs[f"_{key}"]
            assert_same(ours[key][mask], values[mask])


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(("observation", "action"), [("paper", "box"), ("sets", "hybrid"), ("flat", "discrete")])
def test_it_does_what_gymnasiums_does(mode: AutoresetMode, observation: str, action: str) -> None:
    # Missions of different lengths, so that episodes end at different times.
    missions = [Random(seed) for seed in (1, 3, 4, 6)]
    if observation == "paper":
        missions = [Random(seed) for seed in with_as_many_users()]
    arguments = {"observation": observation, "action": action}
    theirs = SyncVectorEnv(
        [lambda mission=mission: MissionEnv(mission, **arguments) for mission in missions],
        autoreset_mode=mode,
    )
    ours = [MissionVectorEnv(1, mission, autoreset_mode=mode, **arguments) for mission in missions]
    observations, infos = theirs.reset(seed=5)
    parts = [env.reset(seed=5) for env in ours]
    for index, part in enumerate(iterate(theirs.observation_space, observations)):
        assert_same(next(iter(iterate(ours[index].observation_space, parts[index][0]))), part)
    theirs.action_space.seed(9)
    for _ in range(200):
        actions = theirs.action_space.sample()
        result = theirs.step(actions)
        singles = list(iterate(theirs.action_space, actions))
        observed = list(iterate(theirs.observation_space, result[0]))
        ended = result[2]
        for index, env in enumerate(ours):
            one = as_batch(singles[index])
            got = env.step(one)
            assert_same(next(iter(iterate(env.observation_space, got[0]))), observed[index])
            assert got[1][0] == result[1][index]
            assert got[2][0] == result[2][index] and not got[3][0]
            if "_final_obs" in result[4] and result[4]["_final_obs"][index]:
                assert_same(got[4]["final_obs"][0], result[4]["final_obs"][index])
                final = result[4]["final_info"]
                for key in ("sum_rate", "arrived", "fair", "mission", "user", "rate"):
                    assert got[4]["final_info"][key][0] == final[key][index]
            else:
                assert "final_obs" not in got[4]
        if mode == AutoresetMode.DISABLED and ended.any():
            theirs.reset(options={"reset_mask": ended.copy()})
            for index in np.flatnonzero(ended):
                ours[index].reset(options={"reset_mask": np.array([True])})


def with_as_many_users() -> list[int]:
    found: dict[int, list[int]] = {}
    for seed in range(200):
        users = Random(seed).missions()[0].users
        found.setdefault(users, []).append(seed)
        if len(found[users]) == 4:
            return found[users]
    raise AssertionError


def as_batch(action: Any) -> Any:
    if isinstance(action, tuple):
        return np.asarray(action[0])[np.newaxis], np.asarray([action[1]])
    return np.asarray(action)[np.newaxis]


@pytest.mark.parametrize("mode", MODES)
def test_infos_are_those_of_gymnasiums_vector_environment(mode: AutoresetMode) -> None:
    theirs = SyncVectorEnv([MissionEnv] * 3, autoreset_mode=mode)
    ours = MissionVectorEnv(3, autoreset_mode=mode)
    assert_same(ours.reset(seed=1)[0], theirs.reset(seed=1)[0])
    ours.action_space.seed(4)
    for _ in range(125):
        actions = ours.action_space.sample()
        a, b = ours.step(actions), theirs.step(actions)
        for one, other in zip(a[:4], b[:4], strict=True):
            assert_same(one, other)
        assert_same_infos(a[4], b[4])
        if mode == AutoresetMode.DISABLED and a[2].any():
            options = {"reset_mask": a[2].copy()}
            assert_same(ours.reset(options=dict(options))[0], theirs.reset(options=options)[0])


@pytest.mark.parametrize("mode", MODES)
def test_make_vec_declares_the_mode(mode: AutoresetMode) -> None:
    envs = gymnasium.make_vec("aircomp_uav/Mission-v0", num_envs=2, autoreset_mode=mode)
    assert isinstance(envs.unwrapped, MissionVectorEnv)
    assert envs.metadata["autoreset_mode"] is mode


@pytest.mark.parametrize("mode", MODES)
def test_the_last_observation_is_never_lost(mode: AutoresetMode) -> None:
    envs = MissionVectorEnv(2, autoreset_mode=mode, normalize=False)
    envs.reset()
    action = np.zeros((2, 17))
    for _ in range(60):
        observation, _, terminated, _, infos = envs.step(action)
    assert terminated.all()
    last = observation
    if mode == AutoresetMode.SAME_STEP:
        assert (observation[:, :15] == 0).all()
        last = np.stack(infos["final_obs"])
    assert (last[:, :15].sum(axis=1) == 60).all()


def test_wrappers_of_gymnasium_work() -> None:
    envs = gymnasium.make_vec("aircomp_uav/Mission-v0", num_envs=3)
    envs = gymnasium.wrappers.vector.RecordEpisodeStatistics(envs)
    envs.reset(seed=0)
    total = np.zeros(3)
    for _ in range(60):
        _, rewards, terminated, _, infos = envs.step(envs.action_space.sample())
        total += rewards
    assert terminated.all()
    np.testing.assert_allclose(infos["episode"]["r"], total)
    np.testing.assert_allclose(infos["return"], total)


def test_results_of_a_step_are_not_written_again() -> None:
    envs = MissionVectorEnv(4)
    envs.reset()
    first = envs.step(envs.action_space.sample())
    kept = [np.copy(array) for array in (*first[:4], first[4]["rate"])]
    for _ in range(70):
        envs.step(envs.action_space.sample())
    for array, copy in zip((*first[:4], first[4]["rate"]), kept, strict=True):
        np.testing.assert_array_equal(array, copy)


def test_arrays_can_be_written_again() -> None:
    fresh, again = MissionVectorEnv(4), MissionVectorEnv(4, copy=False)
    fresh.reset(), again.reset()
    pointers = set()
    for _ in range(130):
        actions = fresh.action_space.sample()
        a, b = fresh.step(actions), again.step(actions)
        for one, other in zip(a[:4], b[:4], strict=True):
            np.testing.assert_array_equal(one, other)
        pointers.add(b[0].ctypes.data)
    assert len(pointers) == 1


def test_seeds_choose_the_missions() -> None:
    envs = MissionVectorEnv(50, Random(0, count=10), "flat", autoreset_mode="SameStep")
    names = []
    for seed in (1, 2, 1, [1] * 50):
        envs.reset(seed=seed)
        names.append([mission.name for mission in envs.missions])
    assert names[0] == names[2] != names[1]
    assert len(set(names[3])) == 1 and len(set(names[0])) == 10


def test_threads_do_not_change_the_numbers() -> None:
    runs = []
    for threads in (1, 2, 7):
        envs = MissionVectorEnv(300, Random(2, count=3), "sets", "hybrid", threads=threads)
        envs.reset(seed=3)
        envs.action_space.seed(1)
        results = [envs.step(envs.action_space.sample()) for _ in range(3)]
        runs.append([(o["users"].tobytes(), r.tobytes()) for o, r, *_ in results])
    assert runs[0] == runs[1] == runs[2]


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_forked_process_steps_as_well() -> None:
    import multiprocessing

    envs = MissionVectorEnv(500, threads=2)
    envs.reset()
    envs.step(np.zeros((500, 17)))
    context = multiprocessing.get_context("fork")
    queue = context.Queue()

    def child() -> None:
        queue.put(float(envs.step(np.zeros((500, 17)))[1].sum()))

    process = context.Process(target=child)
    process.start()
    assert queue.get(timeout=60) == envs.step(np.zeros((500, 17)))[1].sum()
    process.join()


def test_maps_of_all_episodes() -> None:
    envs = MissionVectorEnv(2, render_mode="rgb_array")
    envs.reset()
    envs.step(np.ones((2, 17)))
    frames = envs.render()
    assert frames is not None and [frame.shape for frame in frames] == [(480, 480, 3)] * 2
