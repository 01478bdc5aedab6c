"""The benchmark gives the numbers of ``host-sim benchmark``, to the last digit."""

from __future__ import annotations

import csv
import json
import subprocess
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import aircomp_uav as a
from aircomp_uav import _native

FIRST = 4
STATISTICS = (
    "policy",
    "flown",
    "refused",
    "counted",
    "mean",
    "quantile_5",
    "worst",
    "worst_mission",
    "violations",
    "inaccurate_slots",
)


@pytest.fixture(scope="module")
def host_sim(repository: Path) -> list[str]:
    """Return the command ``host-sim benchmark`` on the first missions."""
    build = ["cargo", "build", "--quiet", "--release", "--locked", "-p", "host-sim"]
    subprocess.run(build, cwd=repository, check=True)
    program = str(repository / "target/release/host-sim")
    return [program, "benchmark", "--first", str(FIRST), "--json"]


@pytest.mark.parametrize("policy", ["plan", "any", "straight-line", "fixed", "models/any.policy"])
def test_the_numbers_are_those_of_host_sim(
    policy: str, host_sim: list[str], repository: Path, tmp_path: Path
) -> None:
    results = tmp_path / "results.csv"
    command = [*host_sim, "--policy", policy, "--results", str(results)]
    run = subprocess.run(command, cwd=repository, capture_output=True, text=True, check=True)
    [expected] = json.loads(run.stdout)
    path = str(repository / policy) if "/" in policy else policy
    result = a.benchmark(path, repository / "benchmarks", first=FIRST)
    for name in STATISTICS:
        assert getattr(result, name) == expected[name], name
    rows = pd.DataFrame(result.missions).set_index("mission")
    with results.open(newline="") as file:
        theirs = {row["mission"]: row for row in csv.DictReader(file)}
    assert set(rows.index) == set(theirs) and len(theirs) == FIRST
    for mission, row in theirs.items():
        ours = rows.loc[mission]
        assert ours["digest"] == row["digest"]
        for name in ("sum_rate", "violations", "inaccurate_slots"):
            assert ours[name] == float(row[name]), (mission, name)
    # The missions that need no files are the same, and so is a flight by several threads.
    drawn = a.benchmark(path, first=FIRST, jobs=2)
    assert drawn.mean == result.mean and drawn.worst == result.worst
    assert (drawn.missions["sum_rate"] == result.missions["sum_rate"]).all()


def test_an_onnx_file_decides_as_with_tract(host_sim: list[str], repository: Path) -> None:
    command = [*host_sim, "--policy", "benchmarks/trained"]
    run = subprocess.run(command, cwd=repository, capture_output=True, text=True, check=True)
    [expected] = json.loads(run.stdout)
    result = a.benchmark(repository / "benchmarks/trained", first=FIRST)
    assert result.flown == expected["flown"] > 0
    for name in ("mean", "quantile_5", "worst"):
        ours, theirs = getattr(result, name), expected[name]
        assert abs(ours - theirs) <= (0 if _native.HAS_TRACT else 1e-5 * theirs), name


def test_a_function_has_the_numbers_of_the_flight() -> None:
    """The straight line through the environment, and with the onboard computer."""

    class StraightLine:
        def predict(self, observation: np.ndarray, deterministic: bool) -> tuple[np.ndarray, None]:
            assert deterministic
            # The shield turns a displacement that is never allowed into the way to the destination.
            return np.zeros(env.action_space.shape, np.float32), None

    mission = a.Random(1).missions()[0]
    env = a.MissionEnv(mission)
    result = a.benchmark(StraightLine(), mission, action="box")
    assert (result.policy, result.flown, result.violations) == ("StraightLine", 1, 0)
    flight = a.fly(mission, StraightLine(), action="box")
    assert result.missions["sum_rate"].item() == flight.sum_rate
    bound, gap = _native.BenchmarkBounds.shipped().of(mission)
    assert result.mean == flight.sum_rate / bound
    assert (result.missions["bound"].item(), result.missions["gap"].item()) == (bound, gap)


def test_the_environment_flies_as_the_onboard_computer(repository: Path) -> None:
    """A network that decides in Python and in the onboard computer."""
    pytest.importorskip("onnxruntime")
    path = repository / "models/separated-sac.onnx"
    onboard = a.benchmark(path, "separated").missions["sum_rate"].item()
    policy = a.load_policy(path)
    reach_m = np.float32(a.load_mission("separated").reach_m)

    def decide(observation: np.ndarray) -> np.ndarray:
        displacement, scores = policy(observation)
        return np.concatenate([displacement / reach_m, scores])

    result = a.benchmark(decide, "separated", normalize=False)
    assert result.policy == "decide"
    assert abs(result.missions["sum_rate"].item() - onboard) <= 1e-6 * onboard


def test_policies_that_do_not_fit_are_refused(repository: Path) -> None:
    result = a.benchmark(repository / "models/separated-sac.onnx", first=2)
    assert (result.flown, result.refused, result.counted) == (0, 2, 0)
    assert np.isnan(result.mean) and np.isnan(result.missions["sum_rate"]).all()
    missions = a.Random(1, count=3).missions()
    users = missions[0].users
    assert any(mission.users != users for mission in missions)

    def for_the_first(observation: np.ndarray) -> np.ndarray:
        return np.zeros(2 + users, np.float32)

    result = a.benchmark(for_the_first, missions)
    fitting = sum(mission.users == users for mission in missions)
    assert (result.flown, result.refused) == (fitting, 3 - fitting)


def test_a_bound_that_is_missing_is_computed_on_request() -> None:
    mission = a.load_mission("separated").changed(slots=50)
    without = a.benchmark("straight-line", mission)
    assert (without.flown, without.counted) == (1, 0) and np.isnan(without.missions["bound"]).all()
    certified = a.benchmark("straight-line", mission, certify=True)
    assert certified.counted == 1 and 0 < certified.mean < 1


def test_wrong_arguments_are_named(tmp_path: Path) -> None:
    for arguments, error, words in [
        (("nonsense",), ValueError, 'policy is "nonsense"'),
        ((tmp_path / "none.policy",), OSError, "none.policy"),
        (("plan", tmp_path), ValueError, "no scenario"),
        ((3,), TypeError, "policy is a int"),
    ]:
        with pytest.raises(error, match=words):
            a.benchmark(*arguments)
    for keywords, error, words in [
        ({"jobs": 0}, ValueError, "jobs is 0"),
        ({"first": 0}, ValueError, "first is 0"),
        ({"first": 1, "profile": "kite"}, ValueError, "profile is"),
        ({"observation": "flat"}, TypeError, "observation: only for functions"),
    ]:
        with pytest.raises(error, match=words):
            a.benchmark("plan", **keywords)
    with pytest.raises(TypeError, match="constraints is fixed"):
        a.benchmark(lambda observation: observation, constraints="penalty")
    with pytest.raises(ValueError, match="fly only 'ideal'"):
        a.benchmark(lambda observation: observation, profile="px4")
