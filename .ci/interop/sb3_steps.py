"""Stable-Baselines3's SAC gradient steps per second, one thread.

    sb3_steps.py [STEPS]

The sizes are those of the default mission and of Table I; trainer/tests/compared_sizes.rs checks
them. SB3 has no hybrid actions: its action is continuous, and its critics return one value.
"""

import sys
import time

import gymnasium
import numpy as np
import torch
from stable_baselines3 import SAC
from stable_baselines3.common.logger import configure

USERS = 15
STATES = USERS + 4
ACTION = USERS + 2
HIDDEN = 128
BATCH = 64
STEPS = int(sys.argv[1]) if len(sys.argv) > 1 else 1_000


class Fixed(gymnasium.Env):
    """Returns random states: what is measured is `train()`."""

    observation_space = gymnasium.spaces.Box(-1, 1, (STATES,), np.float32)
    action_space = gymnasium.spaces.Box(-1, 1, (ACTION,), np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return self.observation_space.sample(), {}

    def step(self, action):
        return self.observation_space.sample(), 0.0, False, False, {}


def main() -> None:
    torch.set_num_threads(1)
    model = SAC("MlpPolicy", Fixed(), policy_kwargs={"net_arch": [HIDDEN, HIDDEN]}, batch_size=BATCH,
                learning_rate=1e-4, gamma=0.90, learning_starts=1_000, train_freq=1_000, seed=1)
    model.set_logger(configure(None, []))
    model.learn(1_000)
    model.train(gradient_steps=100, batch_size=BATCH)
    start = time.perf_counter()
    model.train(gradient_steps=STEPS, batch_size=BATCH)
    print(f"stable-baselines3 {STEPS / (time.perf_counter() - start):.1f}")


if __name__ == "__main__":
    main()
