"""Policies as ONNX files, which ``host-sim run``, ``trainer convert`` and other programs read."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from . import _native
from .missions import ScenarioLike, load_mission


class DenseLayer(NamedTuple):
    """A layer of a network: ``weights @ x + bias``.

    Attributes:
        weights: A row per output, a column per input.
        bias: A number per output.
    """

    weights: npt.NDArray[np.float32]
    bias: npt.NDArray[np.float32]


class _Network(NamedTuple):
    """What an extracted network consists of."""

    layers: list[DenseLayer]
    activation: str
    limit: str


def export_onnx(
    model: Sequence[tuple[npt.ArrayLike, npt.ArrayLike]] | Any,
    scenario: ScenarioLike,
    path: str | os.PathLike[str],
    *,
    activation: str | None = None,
    limit: str | None = None,
    normalize: bool | None = None,
    algorithm: str | None = None,
    episodes: int = 0,
    seed: int | None = None,
) -> None:
    """Write a policy as an ``.onnx`` file of format version 1 (``docs/training.md``).

    The policy must take the observation ``paper`` and return the action ``box`` of
    :class:`MissionEnv`. The file has raw units at its interface: the normalization of the observation
    and the scaling of the displacement to metres are part of the graph. ``metadata_props`` have the
    mission and a test vector, with which all readers check the file.

    The same observation gives the same displacement and the same scores as in the environment, up to
    the rounding of single precision: the scores are limited to [-1, 1] as well.

    Args:
        model: A model of Stable-Baselines3: SAC, or PPO or A2C, with ``MlpPolicy``; its deterministic
            action is exported. Or the layers of a network: pairs of weights (a row per output) and
            biases. The first takes the M + 4 numbers of the observation, the last returns 2 + M
            numbers: displacement and scores.
        scenario: The mission that the policy was trained for, as in :func:`load_mission`.
        path: The file, which is replaced if it exists.
        activation: The function after each hidden layer of ``model`` as layers: ``relu`` (the default)
            or ``tanh``.
        limit: The function after the last layer of ``model`` as layers: ``tanh`` (the default) or
            ``clip`` to [-1, 1], which is what the environment does with actions outside.
        normalize: Whether the policy takes normalized observations. The default is that of the
            environment of a model of Stable-Baselines3, and otherwise ``True``, as in the environment.
        algorithm: The name of the algorithm, at most 16 bytes. The default is the name of the model's
            class, or ``python``.
        episodes: The number of episodes that the policy was trained for.
        seed: The seed of the training; by default that of the model, or 0.

    Raises:
        OSError: The file cannot be written.
        ValueError: The network does not fit the mission or exceeds the limits of the onboard computer
            (6 layers, 256 neurons in a layer); the message has what is wrong.
        TypeError: ``model`` is something else.

    >>> import os, tempfile
    >>> path = os.path.join(tempfile.mkdtemp(), "hover.onnx")
    >>> export_onnx([(np.zeros((17, 19)), np.zeros(17))], "separated", path)
    >>> benchmark = __import__("aircomp_uav").benchmark
    >>> benchmark(path, "separated").violations
    0
    """
    mission = load_mission(scenario)
    if hasattr(model, "policy") and hasattr(model, "get_env"):
        if activation is not None or limit is not None:
            raise TypeError("activation and limit are only for layers; those of the model are known")
        network = _network_of_model(model)
        if normalize is None:
            normalize = _environment_normalizes(model)
        algorithm = algorithm or type(model).__name__.lower()
        if seed is None:
            seed = model.seed
    else:
        network = _Network(_layers(model), activation or "relu", limit or "tanh")
    content = _native.write_onnx(
        mission,
        [(layer.weights, layer.bias) for layer in network.layers],
        activation=network.activation,
        displacement=network.limit,
        scores=network.limit,
        normalize=True if normalize is None else normalize,
        algorithm=algorithm or "python",
        episodes=episodes,
        seed=seed or 0,
    )
    with open(path, "wb") as file:
        file.write(content)


def _layers(layers: Any) -> list[DenseLayer]:
    """Return pairs of arrays as layers in single precision."""
    if not isinstance(layers, (list, tuple)) or not layers:
        raise TypeError(
            f"model is a {type(layers).__name__}, but must be a model of Stable-Baselines3 or a list of "
            "pairs of weights and biases"
        )
    read = []
    for index, layer in enumerate(layers):
        if not isinstance(layer, (list, tuple)) or len(layer) != 2:
            raise TypeError(f"layers[{index}] must be a pair of weights and biases")
        weights, bias = (np.ascontiguousarray(part, np.float32) for part in layer)
        if weights.ndim != 2 or bias.ndim != 1:
            raise ValueError(
                f"layers[{index}] has arrays of the shapes {weights.shape} and {bias.shape}, but must "
                "have weights (outputs, inputs) and biases (outputs,)"
            )
        read.append(DenseLayer(weights, bias))
    return read


def _network_of_model(model: Any) -> _Network:
    """Return the network that a Stable-Baselines3 model decides with."""
    policy = model.policy
    if getattr(model, "get_vec_normalize_env", lambda: None)() is not None:
        raise ValueError(
            "the model was trained with VecNormalize, whose running mean cannot be exported; the "
            "environment normalizes observations itself"
        )
    if getattr(model, "use_sde", False):
        raise ValueError("the model uses state-dependent exploration (use_sde), which is not exported")
    if hasattr(policy, "actor") and hasattr(policy.actor, "latent_pi"):
        # SAC: tanh of the mean.
        extractor = getattr(policy.actor, "features_extractor", None)
        modules, limit = [*policy.actor.latent_pi, policy.actor.mu], "tanh"
    elif hasattr(policy, "mlp_extractor") and hasattr(policy, "action_net"):
        # PPO and A2C: `predict` clips the mean to the action space.
        if getattr(policy, "squash_output", False):
            raise ValueError("a policy with squash_output is not exported")
        extractor = getattr(policy, "pi_features_extractor", None)
        modules, limit = [*policy.mlp_extractor.policy_net, policy.action_net], "clip"
    else:
        raise TypeError(
            f"model is a {type(model).__name__}, but must be SAC, PPO or A2C with MlpPolicy, or a list "
            "of layers"
        )
    if extractor is not None and type(extractor).__name__ != "FlattenExtractor":
        raise ValueError(
            f"the features extractor is {type(extractor).__name__}, but must be FlattenExtractor"
        )
    layers: list[DenseLayer] = []
    activations: set[str] = set()
    for module in modules:
        kind = type(module).__name__
        if kind == "Linear":
            state = {name: _array(value) for name, value in module.state_dict().items()}
            layers.append(DenseLayer(state["weight"], state["bias"]))
        elif kind in ("ReLU", "Tanh"):
            activations.add(kind.lower())
        else:
            raise ValueError(f"the policy has a module {kind}, but may have Linear, ReLU and Tanh")
    if len(activations) > 1:
        raise ValueError("the hidden layers have different activations")
    return _Network(layers, activations.pop() if activations else "relu", limit)


def _array(tensor: Any) -> npt.NDArray[np.float32]:
    return np.ascontiguousarray(tensor.detach().cpu().numpy(), np.float32)


def _environment_normalizes(model: Any) -> bool | None:
    """Return whether the environment of a model normalizes observations; ``None`` if it is unknown.

    Raises:
        ValueError: The environment has another observation or action.
    """
    envs = model.get_env()
    if envs is None:
        return None
    try:
        [settings, *_] = envs.get_attr("policy_interface")
    except (AttributeError, ValueError):
        # An environment that is not ours, or wrapped so that its attributes are not seen.
        return None
    observation, action, normalize = settings
    if (observation, action) != ("paper", "box"):
        raise ValueError(
            f"the environment of the model has observation={observation!r} and action={action!r}, but "
            "only a policy of 'paper' and 'box' can be exported"
        )
    return bool(normalize)
