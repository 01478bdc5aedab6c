"""Certified upper bounds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from . import _native
from ._native import Mission
from .missions import ScenarioLike, load_mission

DEFAULT_GAP = 0.01
"""The relative gap at which a certification stops."""


@dataclass(frozen=True, eq=False)
class CertifiedBound:
    """A certified bound, and a mission that comes close to it.

    Attributes:
        upper: No admissible mission has a larger sum of rates, bit/s/Hz.
        lower: The sum of rates of the mission below, bit/s/Hz.
        gap: ``(upper - lower) / upper``.
        waypoints_m: Where each slot of that mission ends, metres east and north, ``(N, 2)``.
        users: Whom it serves in each slot, ``(N,)``.
        multipliers: The prices of fairness per user, bit/s/Hz.
        cell_m: The side of the smallest cells, metres.
        seconds: The time that the certification took.
    """

    upper: float
    lower: float
    gap: float
    waypoints_m: npt.NDArray[np.float64]
    users: npt.NDArray[np.int64]
    multipliers: npt.NDArray[np.float64]
    cell_m: float
    seconds: float


def certified_bound(
    scenario: ScenarioLike,
    *,
    gap: float = DEFAULT_GAP,
    time_limit_s: float | None = None,
    threads: int | None = None,
) -> CertifiedBound:
    """Certify an upper bound on the sum of rates of every admissible mission.

    The bound holds whatever stops the calculation; ``docs/bound.md`` has the proof. Most missions
    take a second or less at the default gap, and the hardest some tens of seconds. Ctrl-C ends the
    calculation.

    Args:
        scenario: The mission, as in :func:`load_mission`.
        gap: The relative gap between bound and mission at which the calculation stops.
        time_limit_s: The time after which it stops as well.
        threads: The number of threads; by default all. The result does not depend on it, unless
            the time limit stops the calculation.

    >>> bound = certified_bound("separated", gap=0.05)
    >>> bound.lower <= bound.upper, bound.waypoints_m.shape
    (True, (60, 2))
    """
    mission = load_mission(scenario)
    result = _native.certified_bound(mission, gap=gap, time_limit_s=time_limit_s, threads=threads)
    return CertifiedBound(**result)


class BoundCache:
    """The bounds of missions, each calculated when it is first asked for."""

    def __init__(self) -> None:
        self._bounds: dict[tuple[str, float], float] = {}

    def upper(self, mission: Mission, gap: float) -> float:
        """Return the upper bound of a mission, bit/s/Hz."""
        key = (mission.digest, gap)
        if key not in self._bounds:
            self._bounds[key] = certified_bound(mission, gap=gap).upper
        return self._bounds[key]


BOUNDS = BoundCache()
"""The bounds of this process."""


def gap_of(bound: bool | float) -> float | None:
    """Return the gap that the argument ``bound`` of an environment stands for."""
    if isinstance(bound, (bool, np.bool_)):
        return DEFAULT_GAP if bound else None
    if not isinstance(bound, (int, float)):
        raise TypeError(f"bound is {bound!r}, but must be a bool or the gap as a float")
    if not 1e-6 <= bound < 1:
        raise ValueError(f"bound is {bound}, but a gap must be at least 1e-6 and below 1")
    return float(bound)
