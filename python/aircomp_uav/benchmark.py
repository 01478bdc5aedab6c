"""The benchmark: a policy on many missions, as fractions of certified bounds."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _native
from ._native import BenchmarkBounds, BenchmarkFlights, Mission
from .flight import decision_function, fly_in_environment
from .missions import Random, ScenarioLike, load_missions

BENCHMARK_MISSIONS = Random(1, count=200)
"""The missions of the benchmark, ``benchmarks/random-0001.toml`` to ``random-0200.toml``."""


@dataclass(frozen=True)
class BenchmarkResult:
    """The scores of a policy.

    A mission's share is the sum of its rates as a fraction of the certified upper bound. Missions
    count in the shares if the policy fits them and their certified gap is at most 2 %.

    Attributes:
        policy: The name of the policy.
        flown: The number of missions that were flown.
        refused: The number of missions that the policy does not fit.
        counted: The number of missions that count in the shares.
        mean: The mean share.
        quantile_5: The 5 % quantile of the shares (nearest rank).
        worst: The smallest share.
        worst_mission: The mission with the smallest share.
        violations: The number of violated constraints over all flown missions: speed, area, arrival,
            fairness.
        inaccurate_slots: The number of slots in which no choice of powers met the MSE threshold.
        preparation_median_s: The median time to load or plan, seconds.
        preparation_max_s: The longest time to load or plan, seconds.
        decision_median_us: The median over the missions of the median time of a decision,
            microseconds.
        missions: A column per quantity, a row per mission; ``pandas.DataFrame(result.missions)`` makes
            a data frame of it. The columns: ``mission``, ``digest``, ``sum_rate`` (bit/s/Hz, NaN if
            the policy does not fit), ``bound`` and ``gap`` (of the certified upper bound, NaN if
            unknown), ``share``, ``violations``, ``inaccurate_slots``, ``preparation_s`` and
            ``decision_us``.
    """

    policy: str
    flown: int
    refused: int
    counted: int
    mean: float
    quantile_5: float
    worst: float
    worst_mission: str
    violations: int
    inaccurate_slots: int
    preparation_median_s: float
    preparation_max_s: float
    decision_median_us: float
    missions: dict[str, Any] = field(repr=False)


def benchmark(
    policy: str | os.PathLike[str] | Callable[[Any], Any] | Any,
    missions: str | os.PathLike[str] | ScenarioLike | Sequence[ScenarioLike] | None = None,
    *,
    first: int | None = None,
    jobs: int = 1,
    profile: str = "ideal",
    certify: bool = False,
    name: str | None = None,
    **environment: Any,
) -> BenchmarkResult:
    """Fly a policy through many missions and compare its sums of rates with certified bounds.

    A name or a file is flown by the code of ``host-sim benchmark``: the onboard computer, its MAVLink
    client and the vehicle. All numbers but the times are those which that command prints, to the last
    digit. The exception are ``.onnx`` files: they are converted to ``.policy`` files, so that a
    decision may differ in the last digits of single precision (unless the package was built with the
    feature ``onnx``).

    A function, or an object with a method ``predict``, flies through :class:`MissionEnv` with the
    shield, the exact allocation and the ideal vehicle. Shield, channel, allocation, bounds and
    statistics are the same code; what differs is that positions do not pass through MAVLink messages,
    which carry them in single precision. That changes the sum of rates by about 1e-6 of itself, and by
    3e-5 where a network is steep.

    Args:
        policy: What ``host-sim benchmark --policy`` takes: ``plan``, ``plan-once``, ``plan-once:SECONDS``,
            ``search``, ``any``, ``shipped``, ``straight-line``, ``fixed``, a file that ends in
            ``.policy``, ``.onnx``, ``.csv`` or ``.plan``, or a directory of ``.onnx`` files. Or a
            function from an observation to an action, or an object with ``predict`` as in
            Stable-Baselines3, whose actions are deterministic.
        missions: A directory with scenarios and ``bounds.csv``, such as ``benchmarks`` of the
            repository; or a scenario, as in :func:`load_mission`, or a list of them. The default are
            the 200 missions of the benchmark, which need no files.
        first: Fly only the first missions, as many as this.
        jobs: The number of missions that are flown at the same time. Functions and objects with
            ``predict`` are called one after the other. Measured times are comparable only with 1.
        profile: The vehicle: ``ideal``, ``multirotor``, ``arducopter`` or ``px4``. Functions and
            objects with ``predict`` fly only the ideal one.
        certify: Whether bounds that are not known are computed, which mostly takes about a second a
            mission. Missions without a bound do not count in the shares.
        name: The name of a function or object in the result; by default that of its type.
        environment: For functions and objects with ``predict``: further arguments of
            :class:`MissionEnv`, for example ``observation`` and ``action``. With one action space for
            all missions, that is ``observation="flat"`` or ``"sets"``, the policy may fly any mission;
            a mission whose number of users does not fit is counted as refused.

    Raises:
        OSError: A file or directory cannot be read.
        ValueError: An argument is wrong; the message names it.

    >>> result = benchmark("straight-line", first=3)
    >>> result.flown, result.counted, 0 < result.worst <= result.mean <= 1
    (3, 3, True)
    """
    scenarios, bounds = _missions_and_bounds(missions)
    if first is not None:
        if isinstance(first, bool) or not isinstance(first, int):
            raise TypeError(f"first is {first!r}, but must be an int")
        if first < 1:
            raise ValueError(f"first is {first}, but must be at least 1")
        scenarios = scenarios[:first]
    if isinstance(jobs, bool) or not isinstance(jobs, int):
        raise TypeError(f"jobs is {jobs!r}, but must be an int")
    if not 1 <= jobs <= 256:
        raise ValueError(f"jobs is {jobs}, but must be 1 to 256")
    if certify:
        for mission in scenarios:
            if bounds.of(mission) is None:
                bounds.certify(mission)
    if isinstance(policy, (str, os.PathLike)):
        if environment or name is not None:
            given = ", ".join([*environment, *(["name"] if name is not None else [])])
            raise TypeError(f"{given}: only for functions and objects with a method predict")
        path = os.fspath(policy)
        if not isinstance(path, str):
            raise TypeError(f"policy is {policy!r}, but must be a name, a path or a function")
        flights = _native.benchmark_fly(scenarios, path, profile=profile, jobs=jobs)
    else:
        if profile != "ideal":
            raise ValueError(
                f"profile is {profile!r}, but functions and objects with predict fly only 'ideal'"
            )
        for argument in ("constraints", "inner"):
            if argument in environment:
                raise TypeError(f"{argument} is fixed in the benchmark")
        flights = _fly_in_environment(scenarios, policy, name, environment)
    return _result(scenarios, flights, bounds)


def _missions_and_bounds(missions: Any) -> tuple[list[Mission], BenchmarkBounds]:
    if missions is None:
        return BENCHMARK_MISSIONS.missions(), BenchmarkBounds.shipped()
    if isinstance(missions, (str, os.PathLike)) and os.path.isdir(missions):
        directory = os.fspath(missions)
        return _native.benchmark_missions(directory), BenchmarkBounds.read(directory)
    return load_missions(missions), BenchmarkBounds.shipped()


def _fly_in_environment(
    scenarios: list[Mission], policy: Any, name: str | None, environment: dict[str, Any]
) -> BenchmarkFlights:
    decide = decision_function(policy)
    flights = BenchmarkFlights(name or getattr(policy, "__name__", type(policy).__name__))
    refusals = 0
    for mission in scenarios:
        times_us: list[float] = []

        def timed(observation: Any, times_us: list[float] = times_us) -> Any:
            begun = time.perf_counter()
            action = decide(observation)
            times_us.append(1e6 * (time.perf_counter() - begun))
            return action

        begun = time.perf_counter()
        try:
            flight = fly_in_environment(mission, timed, "exact", environment)
        except ValueError:
            # A network for other sizes refuses its first observation, or gives an action of another
            # size. An error in the middle of a flight is one of the policy, and so is one in the last
            # mission if there was one in all others.
            refusals += 1
            if len(times_us) > 1 or refusals == len(scenarios):
                raise
            flights.add(
                mission,
                sum_rate=math.nan,
                violations=0,
                inaccurate_slots=0,
                preparation_s=time.perf_counter() - begun,
                decision_us=math.nan,
            )
            continue
        flights.add(
            mission,
            sum_rate=flight.sum_rate,
            violations=(not flight.arrived) + (not flight.fair),
            inaccurate_slots=flight.mse_violations,
            preparation_s=0.0,
            decision_us=float(np.median(times_us)),
        )
    return flights


def _result(
    scenarios: list[Mission], flights: BenchmarkFlights, bounds: BenchmarkBounds
) -> BenchmarkResult:
    columns = flights.columns()
    known = [bounds.of(mission) or (math.nan, math.nan) for mission in scenarios]
    upper: npt.NDArray[np.float64] = np.array([bound for bound, _ in known])
    columns["bound"] = upper
    columns["gap"] = np.array([gap for _, gap in known])
    with np.errstate(divide="ignore", invalid="ignore"):
        columns["share"] = columns["sum_rate"] / upper
    return BenchmarkResult(**flights.statistics(bounds), missions=columns)
