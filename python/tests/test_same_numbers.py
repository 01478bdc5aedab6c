"""Python and Rust step through the same numbers, bit for bit."""

from __future__ import annotations

import hashlib
import subprocess
from pathlib import Path

import numpy as np
import pytest

from aircomp_uav import MissionEnv, MissionVectorEnv, Random

EPISODES = 1000
MISSIONS = 50


@pytest.fixture(scope="module")
def digests(repository: Path) -> list[str]:
    """Return the digests of the episodes that a Rust program flies, without vector instructions."""
    command = ["cargo", "run", "--quiet", "--release", "--locked", "-p", "environment"]
    command += ["--example", "trajectory", "--", str(EPISODES)]
    run = subprocess.run(command, cwd=repository, capture_output=True, text=True, check=True)
    lines = run.stdout.split()
    assert len(lines) == EPISODES
    return lines


def numbers(seed: int, count: int) -> np.ndarray:
    """Return numbers of the SplitMix64 generator as crates/environment/examples/trajectory.rs does."""
    with np.errstate(over="ignore"):
        steps = np.arange(1, count + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
        z = np.uint64(seed) + steps
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        z ^= z >> np.uint64(31)
    return (z >> np.uint64(40)).astype(np.float32) / np.float32(2**23) - np.float32(1)


def actions_of(episode: int, slots: int, users: int) -> np.ndarray:
    """Return the actions of an episode."""
    return numbers(episode, slots * (2 + users)).reshape(slots, 2 + users)


def test_the_environment_steps_through_the_numbers_of_rust(digests: list[str]) -> None:
    missions = Random(0, count=MISSIONS).missions()
    envs = [MissionEnv(scenario=mission) for mission in missions]
    for episode, expected in enumerate(digests):
        env, mission = envs[episode % MISSIONS], missions[episode % MISSIONS]
        sha = hashlib.sha256()
        observation, _ = env.reset()
        sha.update(observation.astype("<f4").tobytes())
        for action in actions_of(episode, mission.slots, mission.users):
            observation, reward, terminated, _, info = env.step(action)
            sha.update(observation.astype("<f4").tobytes())
            sha.update(np.array([reward, info["rate"], info["mse"]], "<f8").tobytes())
        assert terminated
        assert sha.hexdigest() == expected, episode


@pytest.mark.parametrize("threads", [1, 3])
def test_the_vector_environment_steps_through_the_numbers_of_rust(
    digests: list[str], threads: int
) -> None:
    for index, mission in enumerate(Random(0, count=MISSIONS).missions()):
        episodes = range(index, EPISODES, MISSIONS)
        # Enough of them for several threads: each episode is there several times.
        copies = 5
        envs = MissionVectorEnv(
            len(episodes) * copies, mission, autoreset_mode="Disabled", threads=threads
        )
        hashes = [hashlib.sha256() for _ in range(envs.num_envs)]
        actions = np.stack(
            [actions_of(episode, mission.slots, mission.users) for episode in episodes] * copies,
            axis=1,
        )
        observations, _ = envs.reset()
        for sha, row in zip(hashes, observations, strict=True):
            sha.update(row.astype("<f4").tobytes())
        for slot in range(mission.slots):
            observations, rewards, _, _, infos = envs.step(actions[slot])
            numbers = np.stack([rewards, infos["rate"], infos["mse"]], axis=1).astype("<f8")
            for sha, row, more in zip(hashes, observations, numbers, strict=True):
                sha.update(row.astype("<f4").tobytes())
                sha.update(more.tobytes())
        expected = [digests[episode] for episode in episodes] * copies
        assert [sha.hexdigest() for sha in hashes] == expected
