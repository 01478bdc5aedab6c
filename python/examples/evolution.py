"""Trains a small network by evolution strategies, with NumPy alone, and exports it.

    python python/examples/evolution.py --out separated-es.onnx
    host-sim run --policy separated-es.onnx

In each generation, pairs of opposite perturbations of the parameters fly one episode each, all of
them at once in the vectorized environment. The ranks of their sums of rates weight the perturbations
in an estimate of the gradient (Salimans et al., 2017), which Adam follows. The best network that was
flown is exported, and one line of JSON says what it reached in the environment.
"""

from __future__ import annotations

import argparse
import json
import time

import numpy as np

import aircomp_uav

HIDDEN = 24
STEP_SIZE = 0.05


class Networks:
    """Networks with one hidden layer of ReLU and outputs that `tanh` limits, one per episode."""

    def __init__(self, inputs: int, outputs: int) -> None:
        self.shapes = [(HIDDEN, inputs), (HIDDEN,), (outputs, HIDDEN), (outputs,)]
        self.size = sum(int(np.prod(shape)) for shape in self.shapes)

    def start(self, rng: np.random.Generator) -> np.ndarray:
        """Return the parameters of a network that hardly moves the vehicle."""
        hidden = rng.normal(0, 1 / np.sqrt(self.shapes[0][1]), self.shapes[0])
        rest = np.zeros(self.size - hidden.size)
        return np.concatenate([hidden.ravel(), rest]).astype(np.float32)

    def parts(self, parameters: np.ndarray) -> list[np.ndarray]:
        """Return weights and biases of networks whose parameters are the rows of a matrix."""
        parts, begin = [], 0
        for shape in self.shapes:
            end = begin + int(np.prod(shape))
            parts.append(parameters[:, begin:end].reshape(-1, *shape))
            begin = end
        return parts

    @staticmethod
    def actions(parts: list[np.ndarray], observations: np.ndarray) -> np.ndarray:
        """Return the action of each network for its observation."""
        weights, bias, last_weights, last_bias = parts
        hidden = np.matmul(weights, observations[:, :, None])[:, :, 0] + bias
        np.maximum(hidden, 0, out=hidden)
        return np.tanh(np.matmul(last_weights, hidden[:, :, None])[:, :, 0] + last_bias)


def fly(
    envs: aircomp_uav.MissionVectorEnv, networks: Networks, parameters: np.ndarray
) -> np.ndarray:
    """Return the sum of rates of each network's episode."""
    parts = networks.parts(parameters)
    observations, _ = envs.reset()
    while True:
        observations, _, terminated, _, infos = envs.step(networks.actions(parts, observations))
        if terminated.all():
            return np.asarray(infos["sum_rate"])


def train(
    scenario: str, pairs: int, noise: float, seconds: float, seed: int
) -> tuple[list[tuple[np.ndarray, np.ndarray]], float, int]:
    """Return the layers of the best network, its sum of rates, and the number of episodes."""
    rng = np.random.default_rng(seed)
    envs = aircomp_uav.MissionVectorEnv(2 * pairs, scenario=scenario, autoreset_mode="Disabled")
    [inputs], [outputs] = envs.single_observation_space.shape, envs.single_action_space.shape
    networks = Networks(inputs, outputs)
    center = networks.start(rng)
    best, best_rate = center, -np.inf
    first, second = np.zeros_like(center), np.zeros_like(center)
    begun, generation = time.monotonic(), 0
    while time.monotonic() - begun < seconds:
        generation += 1
        steps = rng.standard_normal((pairs, networks.size), np.float32) * np.float32(noise)
        population = np.concatenate([center + steps, center - steps])
        rates = fly(envs, networks, population)
        if rates.max() > best_rate:
            best, best_rate = population[rates.argmax()], rates.max()
        ranks = rates.argsort().argsort() / (2 * pairs - 1) - 0.5
        gradient = (ranks[:pairs] - ranks[pairs:]) @ steps / (2 * pairs * noise**2)
        gradient *= noise
        first = 0.9 * first + 0.1 * gradient
        second = 0.99 * second + 0.01 * gradient**2
        unbiased = first / (1 - 0.9**generation)
        center = center + STEP_SIZE * unbiased / (
            np.sqrt(second / (1 - 0.99**generation)) + 1e-6
        )
        center = center.astype(np.float32)
    envs.close()
    weights, bias, last_weights, last_bias = (part[0] for part in networks.parts(best[None]))
    layers = [(weights, bias), (last_weights, last_bias)]
    return layers, float(best_rate), generation * 2 * pairs


def main() -> None:
    """Train, export, and say what was reached."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenario", default="separated", help="name or file of the mission")
    parser.add_argument("--out", default="evolution.onnx", help="the file to write")
    parser.add_argument("--seconds", type=float, default=20.0, help="time to train")
    parser.add_argument("--pairs", type=int, default=64, help="pairs of perturbations")
    parser.add_argument("--noise", type=float, default=0.1, help="their standard deviation")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    layers, sum_rate, episodes = train(
        arguments.scenario, arguments.pairs, arguments.noise, arguments.seconds, arguments.seed
    )
    aircomp_uav.export_onnx(
        layers,
        arguments.scenario,
        arguments.out,
        algorithm="es",
        episodes=episodes,
        seed=arguments.seed,
    )
    straight = aircomp_uav.fly(arguments.scenario, "straight-line").sum_rate
    print(json.dumps({"sum_rate": sum_rate, "straight_line": straight, "episodes": episodes}))


if __name__ == "__main__":
    main()
