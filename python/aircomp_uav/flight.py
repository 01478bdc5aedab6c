"""Flights: a policy through a mission, slot by slot."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import numpy as np

from . import _native
from ._native import Mission, Policy
from .missions import ScenarioLike, load_mission
from .policies import OnnxPolicy, load_policy


class Flight(dict[str, np.ndarray]):
    """The table of a flight: a column per quantity, a row per slot.

    ``pandas.DataFrame(flight)`` makes a data frame of it. The columns: ``slot``, ``east_m``,
    ``north_m``, ``user``, ``rate`` (bit/s/Hz), ``mse``, ``feasible``, ``shielded`` (the shield
    changed the action), and for flights of the controller ``user_power_w`` and
    ``normalizing_factor``.

    Attributes:
        mission: The mission.
        arrived: Whether the flight ended within one slot of the destination.
        fair: Whether every user had its quota.
    """

    def __init__(
        self, table: dict[str, np.ndarray], mission: Mission, arrived: bool, fair: bool
    ) -> None:
        super().__init__(table)
        self.mission = mission
        self.arrived = arrived
        self.fair = fair

    @property
    def sum_rate(self) -> float:
        """The sum of the rates, bit/s/Hz, added slot by slot."""
        total = 0.0
        for rate in self["rate"].tolist():
            total += rate
        return total

    @property
    def mse_violations(self) -> int:
        """The number of slots that missed the MSE threshold."""
        return int(np.count_nonzero(~self["feasible"]))

    def __repr__(self) -> str:
        return (
            f"Flight({self.mission.name!r}, sum_rate={self.sum_rate:.4f}, arrived={self.arrived}, "
            f"fair={self.fair}, mse_violations={self.mse_violations})"
        )


def fly(
    scenario: ScenarioLike,
    policy: str | os.PathLike[str] | Policy | OnnxPolicy | Callable[[Any], Any] | Any,
    *,
    inner: str = "exact",
    **environment: Any,
) -> Flight:
    """Fly a policy through a mission on the ideal vehicle.

    Args:
        scenario: The mission, as in :func:`load_mission`.
        policy: What :func:`load_policy` takes or returns, which the controller flies; or a function
            from an observation to an action; or an object with Stable-Baselines3's method
            ``predict``, whose actions are deterministic.
        inner: How powers are chosen: ``exact``, ``alternating``, ``fixed-user-power[:WATTS]`` or
            ``fixed-sensor-power[:WATTS]``.
        environment: For functions and objects with ``predict``: further arguments of
            :class:`MissionEnv`, for example ``observation`` and ``action``.

    >>> flight = fly("separated", "straight-line")
    >>> round(flight.sum_rate, 2), flight.arrived, flight.fair
    (52.61, True, True)
    """
    mission = load_mission(scenario)
    if isinstance(policy, (str, os.PathLike)):
        policy = load_policy(policy)
    if isinstance(policy, Policy):
        if environment:
            raise TypeError(f"{policy} takes no arguments for the environment")
        return Flight(*_native_flight(mission, policy, inner))
    if isinstance(policy, OnnxPolicy):
        policy.check(mission)
        return _fly_onnx(mission, policy, inner)
    return fly_in_environment(mission, decision_function(policy), inner, environment)


def decision_function(policy: Any) -> Callable[[Any], Any]:
    """Return the function from an observation to an action of a policy in Python.

    Raises:
        TypeError: It is neither a function nor an object with ``predict``.
    """
    if hasattr(policy, "predict"):
        predict = policy.predict

        def decide(observation: Any) -> Any:
            return predict(observation, deterministic=True)[0]

        return decide
    if callable(policy):
        return policy
    raise TypeError(
        f"policy is a {type(policy).__name__}, but must be a name, a file, a policy, a "
        "function or an object with a method predict"
    )


def _native_flight(
    mission: Mission, policy: Policy, inner: str
) -> tuple[dict[str, np.ndarray], Mission, bool, bool]:
    table, arrived, fair = _native.fly(mission, policy, inner=inner)
    return table, mission, arrived, fair


def _fly_onnx(mission: Mission, policy: OnnxPolicy, inner: str) -> Flight:
    reach_m = mission.reach_m

    def decide(observation: Any) -> np.ndarray:
        displacement, scores = policy(observation)
        return np.concatenate([displacement / np.float32(reach_m), scores])

    arguments = {"observation": policy.observation, "action": "box", "normalize": False}
    return fly_in_environment(mission, decide, inner, arguments)


def fly_in_environment(
    mission: Mission, decide: Callable[[Any], Any], inner: str, arguments: dict[str, Any]
) -> Flight:
    """Fly a function from an observation to an action through the environment."""
    from .environment import MissionEnv

    env = MissionEnv(scenario=mission, inner=inner, **arguments)
    observation, _ = env.reset()
    names = ("user", "rate", "mse", "feasible", "shielded")
    columns: dict[str, list[Any]] = {name: [] for name in ("slot", "east_m", "north_m", *names)}
    terminated = False
    while not terminated:
        observation, _, terminated, _, info = env.step(decide(observation))
        east_m, north_m = env.position_m
        columns["slot"].append(len(columns["slot"]) + 1)
        columns["east_m"].append(east_m)
        columns["north_m"].append(north_m)
        for name in names:
            columns[name].append(info[name])
    table = {name: np.asarray(column) for name, column in columns.items()}
    return Flight(table, mission, info["arrived"], info["fair"])
