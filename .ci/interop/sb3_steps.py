"""Stable-Baselines3's SAC gradient steps per second, one thread.

    sb3_steps.py [STEPS]

MlpPolicy, net_arch [128, 128], batch 64, the sizes of the default mission (19 states). SB3 has no
hybrid actions: its action is 17 continuous numbers, its critics answer with one value.
"""

import sys
import time

import gymnasium
import numpy as np
import torch
from stable_baselines3 import SAC
from stable_baselines3.common.logger import configure

STEPS = int(sys.argv[1]) if len(sys.argv) > 1 else 1_000


class Fixed(gymnasium.Env):
    """Returns random states: what is measured is `train()`."""

    observation_space = gymnasium.spaces.Box(-1, 1, (19,), np.float32)
    action_space = gymnasium.spaces.Box(-1, 1, (17,), np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return self.observation_space.sample(), {}

    def step(self, action):
        return self.observation_space.sample(), 0.0, False, False, {}


def main() -> None:
    torch.set_num_threads(1)
    model = SAC("MlpPolicy", Fixed(), policy_kwargs={"net_arch": [128, 128]}, batch_size=64,
                learning_rate=1e-4, gamma=0.90, learning_starts=1_000, train_freq=1_000, seed=1)
    model.set_logger(configure(None, []))
    model.learn(1_000)
    model.train(gradient_steps=100, batch_size=64)
    start = time.perf_counter()
    model.train(gradient_steps=STEPS, batch_size=64)
    print(f"stable-baselines3 {STEPS / (time.perf_counter() - start):.1f}")


if __name__ == "__main__":
    main()
