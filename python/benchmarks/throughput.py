"""Slots per second of the environments, from Python.

    python python/benchmarks/throughput.py [--seconds 1] [--threads 2] [--write docs/python.md]

Each row is measured with random actions of the default mission, the environment in Rust and the one
in NumPy (``numpy_environment.py``) in turns, so that what else runs on the machine slows both. The
number is the best of the turns. The rates of both are compared first.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
from numpy_environment import NumpyEnvironment

from aircomp_uav import MissionEnv, MissionVectorEnv, load_mission

BATCHES = (1, 16, 64, 256, 1024, 4096)
TURNS = 5
MARKS = ("<!-- throughput -->", "<!-- /throughput -->")


def check_rates() -> None:
    """Check that both environments have the same rates."""
    mission = load_mission("separated")
    ours, theirs = MissionEnv(mission), NumpyEnvironment(mission)
    rng = np.random.default_rng(1)
    for _ in range(20):
        observation, _ = ours.reset()
        assert np.allclose(observation, theirs.reset(), atol=1e-6)
        # In the middle of the area and of the mission, the shield has nothing to do.
        for slot in range(40):
            action = rng.uniform(-0.2, 0.2, 17).astype(np.float32)
            action[:2] += 0.5
            observation, reward, _, _, info = ours.step(action)
            expected, other, _ = theirs.step(action)
            assert abs(info["rate"] - theirs.rate) < 1e-9, (slot, info["rate"], theirs.rate)
            assert abs(reward - other) < 1e-6
            assert np.allclose(observation, expected, atol=1e-5)


def slots_per_second(step, batch: int, seconds: float) -> float:
    """Return how many slots a function flies per second."""
    count, begun = 0, time.perf_counter()
    while time.perf_counter() - begun < seconds:
        for _ in range(max(1, 512 // batch)):
            step()
        count += max(1, 512 // batch)
    return count * batch / (time.perf_counter() - begun)


def vector(batch: int, threads: int):
    envs = MissionVectorEnv(batch, threads=threads, autoreset_mode="SameStep")
    envs.reset(seed=1)
    envs.action_space.seed(1)
    actions = [envs.action_space.sample() for _ in range(8)]
    turn = iter(range(10**12))
    return lambda: envs.step(actions[next(turn) % 8])


def single():
    env = MissionEnv()
    env.reset(seed=1)
    actions = [env.action_space.sample() for _ in range(8)]
    turn = iter(range(10**12))

    def step() -> None:
        if env.step(actions[next(turn) % 8])[2]:
            env.reset()

    return step


def numpy_loop(batch: int):
    mission = load_mission("separated")
    envs = [NumpyEnvironment(mission) for _ in range(batch)]
    rng = np.random.default_rng(1)
    actions = rng.uniform(-1, 1, (batch, 17)).astype(np.float32)

    def step() -> None:
        for env, action in zip(envs, actions, strict=True):
            if env.step(action)[2]:
                env.reset()

    return step


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=1.0)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--write", type=Path)
    arguments = parser.parse_args()
    check_rates()
    seconds, threads = arguments.seconds / TURNS, arguments.threads
    lines = [
        f"| batch | Rust through Python, {threads} threads, slots/s | 1 thread, slots/s "
        "| NumPy, slots/s | ratio |",
        "|---|---|---|---|---|",
    ]
    for batch in BATCHES:
        steps = [vector(batch, threads), vector(batch, 1), numpy_loop(min(batch, 64))]
        best = [0.0] * 3
        for _ in range(TURNS):
            for index, step in enumerate(steps):
                size = min(batch, 64) if index == 2 else batch
                best[index] = max(best[index], slots_per_second(step, size, seconds))
        lines.append(
            f"| {batch:,} | {best[0]:,.0f} | {best[1]:,.0f} | {best[2]:,.0f} "
            f"| {best[0] / best[2]:.0f} |"
        )
        print(lines[-1], flush=True)
    one = max(slots_per_second(single(), 1, seconds) for _ in range(TURNS))
    lines.append("")
    lines.append(f"The environment of one episode, `MissionEnv`: {one:,.0f} slots/s.")
    print(lines[-1])
    if arguments.write:
        text = arguments.write.read_text()
        before, _, rest = text.partition(MARKS[0])
        _, _, after = rest.partition(MARKS[1])
        table = "\n".join(lines)
        arguments.write.write_text(f"{before}{MARKS[0]}\n{table}\n{MARKS[1]}{after}")


if __name__ == "__main__":
    main()
