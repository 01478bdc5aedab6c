"""Malformed calls raise exceptions: the interpreter never ends, and no state is damaged."""

from __future__ import annotations

import inspect
import random
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest

import aircomp_uav as a
from aircomp_uav import _native

CALLS = 100_000
ALLOWED = (
    ValueError, TypeError, OSError, OverflowError, MemoryError, AttributeError, KeyError,
    gymnasium.error.Error,
)


class Strange:
    """An object that answers every question wrongly."""

    shape = (3,)

    def __float__(self) -> float:
        raise ValueError("no number")

    def __len__(self) -> int:
        return 2**40

    def __getitem__(self, index: Any) -> Any:
        raise IndexError

    def tolist(self) -> Any:
        return self


def values(r: random.Random) -> Any:
    """Return something that is hardly ever right."""
    choices: list[Callable[[], Any]] = [
        lambda: None,
        lambda: r.choice([-1, 0, 1, 2, 17, 2**31, 2**62, 2**63, 2**64, -(2**70), 10**400]),
        lambda: r.choice([np.nan, np.inf, -np.inf, 1e308, -0.0, 1e-320, 0.5]),
        lambda: r.choice(["", "separated", "paper", "box", "\0", "\ud800", "x" * 1000, "Disabled"]),
        lambda: r.choice([b"", b"UAVP\2\0", True, False, 1j, Strange(), object(), a, ...]),
        lambda: array(r),
        lambda: [values(r) for _ in range(r.randrange(4))],
        lambda: tuple(values(r) for _ in range(r.randrange(4))),
        lambda: {r.choice(["mission", "users", 3, None, "reset_mask"]): values(r)},
        lambda: r.choice([a.Random(-1), a.Random(1, count=0), a.Random(2**80), a.Random("x")]),
    ]
    return r.choice(choices)()


def array(r: random.Random) -> np.ndarray:
    """Return an array of any shape, type and layout."""
    shape = r.choice([(), (0,), (1,), (3,), (17,), (3, 17), (3, 2), (17, 3), (0, 17), (1, 1, 1)])
    kind = r.choice(["f4", "f8", "i8", "u8", "i4", "?", "c16", "U3", "O", ">f4", "f2"])
    made = np.zeros(shape, kind)
    if made.size and made.dtype.kind == "f" and r.random() < 0.5:
        made.flat[r.randrange(made.size)] = r.choice([np.nan, np.inf, -np.inf, 6e4])
    if made.size and made.dtype.kind == "i" and r.random() < 0.5:
        made.flat[r.randrange(made.size)] = r.choice([-1, 10**9])
    if made.ndim == 2 and r.random() < 0.3:
        made = np.asfortranarray(made)
    if r.random() < 0.2:
        made.flags.writeable = False
    return made


def targets() -> list[Callable[..., Any]]:
    """Return what is called."""
    mission = a.load_mission("separated")
    env, hybrid, discrete = (a.MissionEnv(action=name) for name in ("box", "hybrid", "discrete"))
    envs = a.MissionVectorEnv(3, autoreset_mode="SameStep")
    sets = a.MissionVectorEnv(3, observation="sets", action="hybrid")
    for one in (env, hybrid, discrete, envs, sets):
        one.reset()
    batch = envs._batch
    planner = a.Planner(mission)
    return [
        env.step,
        hybrid.step,
        discrete.step,
        envs.step,
        sets.step,
        lambda x, y=None: envs.reset(seed=x, options=y),
        lambda x: sets.reset(options={"reset_mask": x}),
        lambda x, y=1: env.reset(seed=x, options=y),
        lambda x, y="paper": a.MissionEnv(x, y),
        lambda x, y="box": a.MissionEnv(action=y, bound=x),
        lambda x, y=8: a.MissionEnv(action="discrete", directions=y, inner=x),
        lambda x, y=1.0: a.MissionEnv(rate_weight=x, arrival_reward=y),
        lambda x, y="shielded": a.MissionVectorEnv(x, constraints=y),
        lambda x, y=None: a.MissionVectorEnv(2, autoreset_mode=x, threads=y),
        a.load_mission,
        mission.gains,
        mission.rates,
        lambda x, y=None: mission.changed(mse_threshold=x, slots=y),
        _native.Mission.from_toml,
        _native.Mission.from_dict,
        _native.Mission.random,
        _native.Mission.shipped,
        lambda x, y=None: batch.step(x, y, [], x, x, x, x, x),
        lambda x, y=None: batch.step(*[x, None], [x], x, y, x, y, x, [y]),
        batch.reset,
        batch.write_masks,
        lambda x, y=None: a.solve_slots(
            x, y, sensor_power_max_w=1, user_power_max_w=1, noise_power_w=1, mse_threshold=0.1
        ),
        lambda x, y=0.1: a.solve_slots(
            np.ones((3, 2)), np.ones(3), sensor_power_max_w=x, user_power_max_w=1,
            noise_power_w=1, mse_threshold=y,
        ),
        _native.solve_slots,
        lambda x: a.certified_bound(mission, gap=x, time_limit_s=0),
        lambda x: a.certified_bound(mission, gap=0.5, time_limit_s=not_long(x)),
        lambda x: planner.advance(min(x, 1000)),
        lambda x: planner.finish(not_long(x)),
        a.load_policy,
        _native.load_policy,
        lambda x: a.fly(mission, x),
        lambda x: a.fly(mission, "straight-line", inner=x),
        lambda x: a.fly(mission, lambda _: x),
        lambda x, y=1: a.Random(x, count=y).missions() if y != 100_000 else None,
    ]


def arity(function: Callable[..., Any]) -> int:
    """Return the number of arguments that a function takes."""
    parameters = inspect.signature(function).parameters.values()
    return sum(parameter.kind is not parameter.KEYWORD_ONLY for parameter in parameters)


def not_long(seconds: Any) -> Any:
    """Return the time limit, unless it is valid: then a wrong one."""
    if seconds is None or (isinstance(seconds, (int, float)) and 0 <= seconds < 1e9):
        return -1.0
    return seconds


def nearly_right(r: random.Random) -> Callable[[], Any]:
    """Return a call of the native code in which one or two arguments are wrong."""
    missions = [a.load_mission("mixed")]
    batch = _native.Batch(
        missions, 3, observation="paper", normalize=True, action="hybrid", directions=8,
        autoreset="SameStep", constraints="penalty", inner="exact", rate_weight=1.0,
        trajectory_weight=1.0, arrival_reward=1.0, threads=2,
    )

    def observation() -> list[np.ndarray]:
        return [np.zeros((3, 19), np.float32)]

    def truths(*shape: int) -> np.ndarray:
        return np.zeros(shape, np.bool_)

    calls: list[tuple[Callable[..., Any], list[Any]]] = [
        (
            batch.step,
            [
                np.zeros((3, 2), np.float32), np.zeros(3, np.int64), observation(), np.zeros(3),
                truths(3), np.zeros((4, 3)), truths(2, 3), np.zeros(3, np.int64), observation(),
            ],
        ),
        (batch.reset, [observation(), truths(3), np.zeros(3, np.uint64)]),
        (batch.write_masks, [truths(3, 15)]),
        (_native.solve_slots, [np.ones((3, 5)), np.ones(3), np.full((3, 4), 0.1), 1]),
        (_native.Mission.from_toml, [missions[0].to_toml(), "name"]),
        (missions[0].rates, [np.ones((3, 2))]),
    ]
    function, arguments = r.choice(calls)
    for _ in range(r.choice([1, 1, 2])):
        index = r.randrange(len(arguments))
        right = arguments[index]
        if isinstance(right, str):
            cut = r.randrange(len(right) + 1)
            arguments[index] = right[:cut] + r.choice(["", "-", "9", "[", "\n"]) + right[cut + 1 :]
        elif isinstance(right, list) and r.random() < 0.5:
            arguments[index] = [values(r)] * r.choice([0, 1, 1, 2])
        elif r.random() < 0.2:
            # One array twice, for reading and writing.
            arguments[index] = r.choice(arguments)
        elif isinstance(right, np.ndarray) and r.random() < 0.5:
            change: list[Callable[[np.ndarray], Any]] = [
                lambda x: x[..., :-1], lambda x: x[::-1], lambda x: x.T, lambda x: x[np.newaxis],
                lambda x: np.full_like(x, 1) * 77, lambda x: x.astype(np.float32) * np.nan,
                lambda x: x.astype(x.dtype.newbyteorder()), lambda x: x.tolist(), frozen,
                lambda x: np.frombuffer(b"\0" * (x.nbytes + 1), np.uint8)[1:].view(x.dtype),
            ]
            try:
                arguments[index] = r.choice(change)(right)
            except (ValueError, TypeError, IndexError, AttributeError):
                # The array is the result of another change.
                arguments[index] = values(r)
        else:
            arguments[index] = values(r)
    return lambda: function(*arguments)


def frozen(array: np.ndarray) -> np.ndarray:
    """Return an array that must not be written to."""
    array.flags.writeable = False
    return array


def call_all(calls: int, seed: int) -> dict[str, int]:
    """Call everything with anything, and return how often each exception was raised."""
    r = random.Random(seed)
    functions = [(function, arity(function)) for function in targets()]
    counts: dict[str, int] = {}
    for _ in range(calls):
        if r.random() < 0.5:
            function: Callable[..., Any] = nearly_right(r)
            arguments: list[Any] = []
        else:
            function, most = r.choice(functions)
            arguments = [values(r) for _ in range(r.randint(1, most))]
        try:
            function(*arguments)
            name = "none"
        except ALLOWED as error:
            name = type(error).__name__
        counts[name] = counts.get(name, 0) + 1
    return counts


def test_malformed_calls_raise_exceptions() -> None:
    # In a process of its own, so that one that ends fails this test only.
    program = f"import test_malformed; print(test_malformed.call_all({CALLS}, seed=1))"
    run = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", program],
        cwd=__file__.rsplit("/", 1)[0], capture_output=True, text=True,
    )
    assert run.returncode == 0, run.stderr[-3000:]
    counts = eval(run.stdout.splitlines()[-1])  # noqa: S307
    assert sum(counts.values()) == CALLS
    assert counts["ValueError"] > CALLS / 10 and counts["TypeError"] > CALLS / 5


def test_a_wrong_action_changes_nothing() -> None:
    envs = a.MissionVectorEnv(2)
    envs.reset()
    actions = np.zeros((2, 17), np.float32)
    actions[1, 3] = np.nan
    with pytest.raises(ValueError, match=r"actions\[1\]\[3\] is NaN, but must be finite"):
        envs.step(actions)
    assert envs._batch.slots_done().tolist() == [0, 0]


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: a.load_mission("nowhere.toml"), FileNotFoundError, "nowhere.toml: No such file"),
        (lambda: a.load_mission("sepparated"), ValueError, "must be one of separated, mixed, slow"),
        (lambda: a.load_mission(3), TypeError, "scenario is a int"),
        (lambda: a.load_mission({"mission": {}}), ValueError, "missing field"),
        (lambda: a.load_mission({"mission": {1: 2}}), TypeError, "scenario.mission has the key 1"),
        (lambda: a.MissionEnv(observation="papr"), ValueError, '"papr", but must be paper, sets or'),
        (lambda: a.MissionEnv(inner="best"), ValueError, "must be exact, alternating"),
        (lambda: a.MissionEnv(inner="fixed-user-power:9"), ValueError, "9 W is above users.power_max_w"),
        (lambda: a.MissionVectorEnv(2**40), ValueError, "must be 1 to 1048576"),
        (lambda: a.MissionVectorEnv(-1), OverflowError, "negative"),
        (lambda: a.MissionEnv(a.Random(0, count=9)), ValueError, "needs as many in each"),
        (lambda: a.load_policy("fastest"), ValueError, "no policy is named"),
        (lambda: a.certified_bound("slow", gap=2), ValueError, "gap is 2"),
        (
            lambda: a.load_mission("separated").changed(mse_threshold=0.5),
            ValueError,
            "mse_threshold",
        ),
        (
            lambda: a.solve_slots([[1.0, -1.0]], [1.0], sensor_power_max_w=1, user_power_max_w=1,
                                  noise_power_w=1, mse_threshold=0.1),
            ValueError,
            r"slot 0: sensor_gain\[1\] is -1, but must be a finite power gain",
        ),
    ],
)
def test_messages_say_what_is_wrong(
    call: Callable[[], Any], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        call()
