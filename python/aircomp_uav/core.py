"""What the single and the vectorized environment have in common."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from ._native import Batch, Mission
from .bounds import BOUNDS
from .missions import ScenarioLike, load_missions

SETS_NAMES = ("mission", "users", "user_mask", "sensors", "sensor_mask")
"""The arrays of the observation ``sets``, in the order of policy files of format version 2."""

TERM_NAMES = ("rate", "mse", "reward_rate", "reward_trajectory")
FLAG_NAMES = ("feasible", "shielded")

OBSERVATIONS = ("paper", "sets", "flat")
ACTIONS = ("box", "hybrid", "discrete")

ENTROPY_MAX = 2**63


def make_batch(
    count: int,
    autoreset: str,
    *,
    scenario: ScenarioLike | Sequence[ScenarioLike],
    observation: str,
    action: str,
    normalize: bool | None,
    directions: int,
    constraints: str,
    inner: str,
    rate_weight: float,
    trajectory_weight: float,
    arrival_reward: float,
    threads: int | None,
) -> tuple[Batch, list[Mission]]:
    """Make the episodes of an environment."""
    missions = load_missions(scenario)
    _, _, normalize = policy_interface(observation, action, normalize)
    batch = Batch(
        missions,
        count,
        observation=observation,
        normalize=normalize,
        action=action,
        directions=directions,
        autoreset=autoreset,
        constraints=constraints,
        inner=inner,
        rate_weight=rate_weight,
        trajectory_weight=trajectory_weight,
        arrival_reward=arrival_reward,
        threads=threads,
    )
    return batch, missions


# Bounds of observations. No mission has larger numbers in metres, slots or decibels; Gymnasium
# recommends finite bounds, from which samples can be drawn.
OBSERVATION_LIMIT = 1e9


def policy_interface(
    observation: str, action: str, normalize: bool | None
) -> tuple[str, str, bool]:
    """Return the observation, the action, and whether observations are normalized."""
    return observation, action, observation != "sets" if normalize is None else normalize


def observation_space(batch: Batch, observation: str) -> spaces.Space[Any]:
    """Return the space of one episode's observation."""

    limit = OBSERVATION_LIMIT

    def box(shape: list[int], low: float = -limit, high: float = limit) -> spaces.Box:
        return spaces.Box(low, high, tuple(shape), np.float32)

    shapes = batch.observation_shapes
    if observation != "sets":
        return box(shapes[0])
    return spaces.Dict(
        {
            name: box(shape, 0.0, 1.0) if name.endswith("_mask") else box(shape)
            for name, shape in zip(SETS_NAMES, shapes, strict=True)
        }
    )


def action_space(batch: Batch, action: str, directions: int) -> spaces.Space[Any]:
    """Return the space of one episode's action."""
    if action == "box":
        return spaces.Box(-1.0, 1.0, (2 + batch.users,), np.float32)
    if action == "hybrid":
        displacement = spaces.Box(-1.0, 1.0, (2,), np.float32)
        return spaces.Tuple((displacement, spaces.Discrete(batch.users)))
    return spaces.Discrete((1 + directions) * batch.users)


class Arrays:
    """The arrays that a step writes to."""

    def __init__(self, batch: Batch) -> None:
        count = batch.count
        self.rewards = np.empty(count)
        self.terminated = np.empty(count, np.bool_)
        self.terms = np.empty((len(TERM_NAMES), count))
        self.flags = np.empty((len(FLAG_NAMES), count), np.bool_)
        self.users = np.empty(count, np.int64)


def observation_arrays(batch: Batch) -> list[npt.NDArray[np.float32]]:
    """Return arrays for the observations of all episodes."""
    count = batch.count
    return [np.zeros((count, *shape), np.float32) for shape in batch.observation_shapes]


def as_observation(arrays: list[npt.NDArray[np.float32]]) -> Any:
    """Return the observation that consists of these arrays."""
    if len(arrays) == 1:
        return arrays[0]
    return dict(zip(SETS_NAMES, arrays, strict=True))


def numbers(values: Any, name: str) -> npt.NDArray[np.float32]:
    """Return real numbers as a contiguous array in single precision."""
    if type(values) is np.ndarray and values.dtype == np.float32 and values.flags.c_contiguous:
        return values
    array = np.asarray(values)
    if array.dtype.kind not in "iufb":
        raise TypeError(f"{name} has the type {array.dtype}, but must have real numbers")
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(array, np.float32)


def integers(values: Any, name: str) -> npt.NDArray[np.int64]:
    """Return whole numbers as a contiguous array."""
    if type(values) is np.ndarray and values.dtype == np.int64 and values.flags.c_contiguous:
        return values
    array = np.asarray(values)
    if array.dtype.kind not in "iu":
        raise TypeError(f"{name} has the type {array.dtype}, but must have integers")
    return np.ascontiguousarray(array, np.int64)


def pair_of_actions(actions: Any) -> tuple[Any, Any]:
    """Return displacements and users of hybrid actions."""
    if not isinstance(actions, (tuple, list)) or len(actions) != 2:
        raise TypeError("a hybrid action must be a tuple: displacement and user")
    return actions[0], actions[1]


def upper_bound(mission: Mission, gap: float) -> float:
    """Return the certified bound of a mission, from the cache if it is there."""
    return BOUNDS.upper(mission, gap)
