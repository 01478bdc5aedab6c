"""Policies that are exported decide as in the environment."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import aircomp_uav as a

USERS = 15
INPUTS, OUTPUTS = USERS + 4, USERS + 2


def layers(widths: list[int], scale: float = 1.0) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return random layers."""
    rng = np.random.default_rng(3)
    sizes = [INPUTS, *widths, OUTPUTS]
    return [
        (
            scale * rng.normal(0, 1 / np.sqrt(before), (after, before)).astype(np.float32),
            rng.normal(0, 0.3, after).astype(np.float32),
        )
        for before, after in zip(sizes, sizes[1:])
    ]


def action_of(network: list[Any], activation: str, limit: str, observation: np.ndarray) -> np.ndarray:
    """Return the action of a network in double precision."""
    activations = {"relu": lambda x: np.maximum(x, 0), "tanh": np.tanh}
    limits = {"tanh": np.tanh, "clip": lambda x: np.clip(x, -1, 1)}
    x = observation.astype(np.float64)
    for index, (weights, bias) in enumerate(network):
        x = weights.astype(np.float64) @ x + bias
        if index + 1 < len(network):
            x = activations[activation](x)
    return limits[limit](x)


@pytest.mark.parametrize("normalize", [True, False])
@pytest.mark.parametrize("limit", ["tanh", "clip"])
@pytest.mark.parametrize("activation", ["relu", "tanh"])
def test_a_file_decides_as_the_network(
    activation: str, limit: str, normalize: bool, tmp_path: Path
) -> None:
    pytest.importorskip("onnxruntime")
    # Unnormalized observations are up to 1,000.
    network = layers([32, 24], 3.0 if normalize else 0.05)
    path = tmp_path / "policy.onnx"
    a.export_onnx(
        network, "separated", path, activation=activation, limit=limit, normalize=normalize, seed=7
    )
    policy = a.load_policy(path)
    assert (policy.format_version, policy.metadata["algorithm"]) == (1, "python")
    assert (policy.metadata["seed"], policy.metadata["scenario"]) == ("7", "separated")
    assert len(policy.metadata["test_observation"].split(",")) == INPUTS
    policy.check(a.load_mission("separated"))
    raw, taken = (a.MissionEnv(normalize=value) for value in (False, normalize))
    reach_m = raw.mission.reach_m
    (observation, _), (seen, _) = raw.reset(), taken.reset()
    terminated, limited = False, 0
    while not terminated:
        displacement, scores = policy(observation)
        action = action_of(network, activation, limit, seen)
        got = np.concatenate([displacement / reach_m, scores])
        np.testing.assert_allclose(got, action, atol=1e-5)
        limited += int((np.abs(action) > 0.99).sum())
        observation, _, terminated, _, _ = raw.step(action)
        seen, *_ = taken.step(action)
    assert limited > 0 or not normalize
    # The file of the onboard computer flies as the network does in the environment. Where a random
    # network is steep, what is rounded in one slot is larger in the next.
    onboard = a.benchmark(path, "separated").missions["sum_rate"].item()
    flight = a.fly(
        "separated",
        lambda observation: action_of(network, activation, limit, observation),
        normalize=normalize,
    )
    assert abs(onboard - flight.sum_rate) <= 1e-4 * flight.sum_rate


class Parameter:
    """What is read of a tensor of torch."""

    def __init__(self, array: np.ndarray) -> None:
        self.array = array

    def detach(self) -> Parameter:
        return self

    def cpu(self) -> Parameter:
        return self

    def numpy(self) -> np.ndarray:
        return self.array


class Linear:
    def __init__(self, layer: tuple[np.ndarray, np.ndarray]) -> None:
        self.layer = layer

    def state_dict(self) -> dict[str, Parameter]:
        return {"weight": Parameter(self.layer[0]), "bias": Parameter(self.layer[1])}


class ReLU:
    pass


class Tanh:
    pass


class Dropout:
    pass


class PPO:
    """What is read of a model of Stable-Baselines3; the real ones are in test_stable_baselines3.py."""

    def __init__(self, network: list[Any], activation: type, env: Any = None) -> None:
        hidden = [module for layer in network[:-1] for module in (Linear(layer), activation())]
        self.policy = SimpleNamespace(
            mlp_extractor=SimpleNamespace(policy_net=hidden), action_net=Linear(network[-1])
        )
        self.seed = 5
        self.env = env

    def get_env(self) -> Any:
        return self.env and SimpleNamespace(get_attr=lambda name: [getattr(self.env, name)])


def test_a_model_is_read_layer_by_layer(tmp_path: Path) -> None:
    network = layers([16, 16])
    model = PPO(network, Tanh, a.MissionEnv(normalize=False))
    a.export_onnx(model, "separated", tmp_path / "model.onnx")
    a.export_onnx(
        network,
        "separated",
        tmp_path / "layers.onnx",
        activation="tanh",
        limit="clip",
        normalize=False,
        algorithm="ppo",
        seed=5,
    )
    assert (tmp_path / "model.onnx").read_bytes() == (tmp_path / "layers.onnx").read_bytes()
    with pytest.raises(ValueError, match="a module Dropout"):
        a.export_onnx(PPO(network, Dropout), "separated", tmp_path / "none.onnx")
    with pytest.raises(ValueError, match="observation='flat'"):
        model = PPO(network, Tanh, a.MissionEnv(observation="flat"))
        a.export_onnx(model, "separated", tmp_path / "none.onnx")
    with pytest.raises(TypeError, match="activation and limit are only for layers"):
        a.export_onnx(model, "separated", tmp_path / "none.onnx", activation="relu")
    assert not (tmp_path / "none.onnx").exists()


def test_networks_that_do_not_fit_are_named(tmp_path: Path) -> None:
    path = tmp_path / "none.onnx"
    good = layers([8])
    for model, error, words in [
        (layers([8])[:1], ValueError, "the last layer has 8 outputs, but must have 17"),
        ([good[1]], ValueError, r"layers\[0\] has weights \(17, 8\) .* \(outputs, 19\)"),
        ([good[0], (good[1][0], np.zeros(3))], ValueError, r"layers\[1\] .* and 3 biases"),
        ([good[0], (good[1][0] * np.nan, good[1][1])], ValueError, r"layers\[1\] .* not finite"),
        (layers([300]), ValueError, "256"),
        (layers([8] * 6), ValueError, "7 layers, at most 6"),
        ([], TypeError, "a model of Stable-Baselines3 or a list"),
        ("sac", TypeError, "model is a str"),
        ([np.zeros((17, 19))], TypeError, r"layers\[0\] must be a pair"),
    ]:
        with pytest.raises(error, match=words):
            a.export_onnx(model, "separated", path)
    with pytest.raises(ValueError, match="activation is 'gelu'|activation is \"gelu\""):
        a.export_onnx(good, "separated", path, activation="gelu")
    with pytest.raises(ValueError, match="algorithm is"):
        a.export_onnx(good, "separated", path, algorithm="a name that is too long")
    with pytest.raises(OSError):
        a.export_onnx(good, "separated", tmp_path / "nowhere" / "policy.onnx")
    assert not path.exists()
