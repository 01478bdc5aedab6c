"""Missions from files, names, dictionaries, or at random."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias, Union

from ._native import SHIPPED, Mission


@dataclass(frozen=True)
class Random:
    """Missions of the benchmark's distribution.

    The mission of a seed is that of ``host-sim scenario random --seed SEED``.

    Args:
        seed: The seed of the first mission, at least 0.
        count: The number of missions: those of ``seed`` to ``seed + count - 1``. An environment
            with more than one flies one of them in each episode, drawn at random.
        layout: How users and sensors lie: ``uniform``, ``clustered``, ``ring``, ``line`` or
            ``corner``; by default that is drawn as well.

    >>> [mission.users for mission in Random(7, count=3).missions()]
    [12, 8, 6]
    """

    seed: int
    count: int = 1
    layout: str | None = None

    def missions(self) -> list[Mission]:
        """Draw the missions."""
        if isinstance(self.count, bool) or not isinstance(self.count, int):
            raise TypeError(f"count is {self.count!r}, but must be an int")
        if not 1 <= self.count <= 100_000:
            raise ValueError(f"count is {self.count}, but must be 1 to 100000")
        if isinstance(self.seed, bool) or not isinstance(self.seed, int):
            raise TypeError(f"seed is {self.seed!r}, but must be an int")
        if not 0 <= self.seed < 2**63:
            raise ValueError(f"seed is {self.seed}, but must be at least 0 and below 2**63")
        return [Mission.random(self.seed + index, self.layout) for index in range(self.count)]


ScenarioLike: TypeAlias = Union[Mission, Random, str, "os.PathLike[str]", Mapping[str, Any]]
"""What a mission can be made of."""


def load_mission(scenario: ScenarioLike) -> Mission:
    """Return the mission of a scenario.

    Args:
        scenario: The path of a scenario file, the name of a built-in scenario (``separated``,
            ``mixed`` or ``slow``), the tables of a scenario file as a dictionary, a
            :class:`Random` with one mission, or a mission.

    Raises:
        OSError: The file cannot be read.
        ValueError: It is not a valid scenario; the message names the field and what is allowed.
        TypeError: ``scenario`` is something else.

    >>> load_mission("separated")
    Mission("separated", slots=60, users=15, sensors=36)
    """
    missions = load_missions(scenario)
    if len(missions) != 1:
        raise ValueError(f"{scenario!r} stands for {len(missions)} missions, but one is needed")
    return missions[0]


def load_missions(scenario: ScenarioLike | Sequence[ScenarioLike]) -> list[Mission]:
    """Return the missions of a scenario or of a list of them."""
    if isinstance(scenario, Mission):
        return [scenario]
    if isinstance(scenario, Random):
        return scenario.missions()
    if isinstance(scenario, str):
        if scenario in SHIPPED:
            return [Mission.shipped(scenario)]
        if not (scenario.endswith(".toml") or os.path.exists(scenario)):
            names = ", ".join(SHIPPED)
            raise ValueError(
                f"scenario is {scenario!r}, but must be one of {names}, or a scenario file"
            )
        return [Mission.from_path(scenario)]
    if isinstance(scenario, os.PathLike):
        return [Mission.from_path(os.fspath(scenario))]
    if isinstance(scenario, Mapping):
        return [Mission.from_dict(dict(scenario))]
    if isinstance(scenario, (list, tuple)):
        if not scenario:
            raise ValueError("the list of scenarios is empty")
        return [mission for one in scenario for mission in load_missions(one)]
    raise TypeError(
        f"scenario is a {type(scenario).__name__}, but must be a path, a name, a dict, a Random, "
        "a Mission or a list of these"
    )
