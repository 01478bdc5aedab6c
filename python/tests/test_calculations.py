"""Slots, bounds, planner, policies and flights."""

from __future__ import annotations

import importlib.util
import json
import os
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import aircomp_uav as a

HAS_ONNXRUNTIME = importlib.util.find_spec("onnxruntime") is not None


def test_slots_are_those_of_the_reference(repository: Path) -> None:
    """Rates of the independent reference, if its file is there, and otherwise of the mission."""
    mission = a.load_mission("separated")
    rng = np.random.default_rng(1)
    places = rng.uniform(0, 1000, (500, 2))
    user_gains, sensor_gains = mission.gains(places)
    rates = mission.rates(places)
    for user in range(mission.users):
        slots = a.solve_slots(
            sensor_gains,
            user_gains[:, user],
            sensor_power_max_w=mission.sensor_power_max_w,
            user_power_max_w=mission.user_power_max_w,
            noise_power_w=mission.noise_power_w,
            mse_threshold=mission.mse_threshold,
        )
        np.testing.assert_array_equal(np.where(slots.feasible, slots.rate, 0), rates[:, user])
        assert (slots.mse[slots.feasible] <= mission.mse_threshold).all()
        assert (slots.mse[~slots.feasible] > mission.mse_threshold).all()
        assert (slots.user_power_w <= mission.user_power_max_w).all()
        assert (slots.sensor_coefficients**2 <= mission.sensor_power_max_w).all()
        # The MSE of the average as the paper prints it.
        received = slots.sensor_coefficients * np.sqrt(sensor_gains)
        eta = slots.normalizing_factor[:, None]
        noise = slots.user_power_w * user_gains[:, user] + mission.noise_power_w
        mse = ((eta * received - 1) ** 2).sum(axis=1) + slots.normalizing_factor**2 * noise
        np.testing.assert_allclose(slots.mse, mse / mission.sensors**2, rtol=1e-9)


def test_slots_of_many_sensors_and_none() -> None:
    rng = np.random.default_rng(2)
    limits = {"sensor_power_max_w": 0.05, "user_power_max_w": 0.2, "noise_power_w": 1e-12}
    gains = rng.uniform(1e-11, 1e-9, (3, 500))
    slots = a.solve_slots(gains, np.full(3, 1e-11), mse_threshold=0.001, **limits)
    assert slots.feasible.all() and slots.sensor_coefficients.shape == (3, 500)
    empty = a.solve_slots(np.empty((0, 4)), np.empty(0), mse_threshold=0.1, **limits)
    assert empty.rate.shape == (0,)


def test_bounds_enclose_the_best_mission() -> None:
    bound = a.certified_bound("mixed")
    assert bound.lower <= bound.upper and bound.gap <= 0.01
    flight = a.fly("mixed", "plan")
    assert flight.sum_rate <= bound.upper
    assert flight.sum_rate > 0.98 * bound.upper
    steps = np.diff(np.vstack([a.load_mission("mixed").start_m, bound.waypoints_m]), axis=0)
    assert np.hypot(*steps.T).max() <= 30 + 1e-6
    assert np.bincount(bound.users).min() >= 4


def test_a_time_limit_ends_a_certification_with_a_bound() -> None:
    mission = a.load_mission("separated")
    short = a.certified_bound(mission, gap=1e-5, time_limit_s=0.2)
    assert short.upper > 61.8 and short.gap > 1e-5


@pytest.fixture
def ctrl_c_raises() -> Iterator[None]:
    """A shell that starts the tests in the background has them ignore the signal of Ctrl-C."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("ctrl_c_raises")
def test_ctrl_c_ends_long_calls() -> None:
    mission = a.load_mission("separated").changed(slots=300)
    calls = [
        lambda: a.certified_bound(mission, gap=1e-6),
        lambda: a.Planner(mission).finish(),
    ]
    for call in calls:
        timer = threading.Timer(0.5, lambda: os.kill(os.getpid(), signal.SIGINT))
        begun = time.monotonic()
        timer.start()
        with pytest.raises(KeyboardInterrupt):
            call()
        assert time.monotonic() - begun < 20
        timer.join()


def test_other_threads_run_during_long_calls() -> None:
    count = 0
    done = threading.Event()

    def work() -> None:
        nonlocal count
        while not done.is_set():
            count += 1
            time.sleep(0.005)

    thread = threading.Thread(target=work)
    thread.start()
    a.certified_bound("separated", gap=1e-5, time_limit_s=0.5)
    done.set()
    thread.join()
    assert count > 10


def test_the_planner_gets_better() -> None:
    planner = a.Planner(a.load_mission("separated"))
    values = [planner.value]
    while not planner.advance(30_000_000):
        values.append(planner.value)
    assert planner.finished and planner.value >= max(values) > 55
    assert planner.waypoints_m().shape == (60, 2) and len(planner.users()) == 60
    upper = planner.upper_estimate
    assert upper is not None and upper >= planner.value * 0.999


@pytest.mark.parametrize("policy", ["straight-line", "fixed", "any", "plan"])
def test_flights_are_tables(policy: str) -> None:
    pandas = pytest.importorskip("pandas")
    flight = a.fly("separated", policy)
    table = pandas.DataFrame(flight)
    assert table.shape == (60, 10) and table["slot"].tolist() == list(range(1, 61))
    assert flight.arrived and flight.fair and flight.mse_violations == 0
    assert flight.sum_rate == pytest.approx(table["rate"].sum())


def test_flights_are_those_of_the_command_line(repository: Path) -> None:
    """The table of results has the totals of host-sim."""
    assert round(a.fly("separated", "straight-line").sum_rate, 2) == 52.61
    assert round(a.fly("mixed", "straight-line").sum_rate, 2) == 58.26
    path = repository / "models" / "any.policy"
    assert a.load_policy(path).format_version == 2
    assert a.fly("separated", path).sum_rate == a.fly("separated", "any").sum_rate


@pytest.mark.skipif(not HAS_ONNXRUNTIME, reason="onnxruntime is not installed")
@pytest.mark.parametrize(("name", "total"), [("separated-sac.onnx", 60.57), ("any.onnx", None)])
def test_onnx_policies_fly(repository: Path, name: str, total: float | None) -> None:
    flight = a.fly("separated", repository / "models" / name)
    expected = a.fly("separated", "any").sum_rate if total is None else total
    assert flight.sum_rate == pytest.approx(expected, abs=0.006)
    if total is not None:
        with pytest.raises(ValueError, match="the policy is for max_speed_mps = 30"):
            a.fly("slow", repository / "models" / name)


@pytest.mark.skipif(HAS_ONNXRUNTIME, reason="onnxruntime is installed")
def test_onnx_needs_onnxruntime(repository: Path) -> None:
    with pytest.raises(ImportError, match="pip install onnxruntime"):
        a.load_policy(repository / "models" / "any.onnx")


def test_functions_and_objects_with_predict_fly() -> None:
    def toward(observation: np.ndarray) -> np.ndarray:
        return np.full(17, 0.5, np.float32)

    class Model:
        def predict(self, observation: np.ndarray, deterministic: bool) -> tuple[np.ndarray, None]:
            assert deterministic
            return toward(observation), None

    one, other = a.fly("separated", toward), a.fly("separated", Model())
    assert one.sum_rate == other.sum_rate > 0
    assert one.arrived and one.fair


def test_missions_make_the_round_trip(tmp_path: Path, repository: Path) -> None:
    tomllib = pytest.importorskip("tomllib")  # Python 3.11

    mission = a.load_mission(a.Random(3))
    path = tmp_path / "mission.toml"
    path.write_text(mission.to_toml())
    again = a.load_mission(path)
    assert again.digest == mission.digest and again.name == "mission"
    tables = tomllib.loads(mission.to_toml())
    tables["users"]["positions_m"] = mission.user_positions_m
    assert a.load_mission(tables).digest == mission.digest
    benchmark = a.load_mission(repository / "benchmarks" / "random-0003.toml")
    assert benchmark.digest == mission.digest
    assert a.load_mission("separated") == a.load_mission(repository / "scenarios/separated.toml").__class__.shipped("separated")


def test_bounds_of_the_benchmark_hold(repository: Path) -> None:
    rows = (repository / "benchmarks" / "bounds.csv").read_text().splitlines()[1:4]
    for row in rows:
        name, digest, upper, lower, *_ = row.split(",")
        mission = a.load_mission(repository / "benchmarks" / f"{name}.toml")
        assert mission.digest == digest
        bound = a.certified_bound(mission, gap=0.02)
        assert bound.upper >= float(lower) and bound.lower <= float(upper)


def test_memory_does_not_grow() -> None:
    resource = pytest.importorskip("resource")
    envs = a.MissionVectorEnv(256, copy=True)
    actions = np.zeros((256, 17), np.float32)
    envs.reset()
    used = []
    for _ in range(3):
        for _ in range(400):
            envs.step(actions)
        used.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    assert used[-1] - used[0] < 20_000, json.dumps(used)
