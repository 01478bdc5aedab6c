"""The environment in plain NumPy, for comparisons of speed.

It is written as one would write it from the paper, vectorized over nodes: the probabilistic
line-of-sight channel, the exact slot solution by a sort and running sums, the projection of the
displacement, the fairness rule, and the paper's observation and reward. A batch of it is stepped in
a loop, as Gymnasium's ``SyncVectorEnv`` does.
"""

from __future__ import annotations

import numpy as np

from aircomp_uav import Mission

SPEED_OF_LIGHT_MPS = 299_792_458.0


class NumpyEnvironment:
    """One episode of a mission with the channel of the paper's Table I."""

    def __init__(self, mission: Mission, carrier_hz: float = 2e9) -> None:
        self.users_m = mission.user_positions_m
        self.nodes_m = np.vstack([mission.sensor_positions_m, mission.user_positions_m])
        self.sensors = mission.sensors
        self.users = mission.users
        self.slots = mission.slots
        self.quota = mission.quota
        self.altitude_m = mission.altitude_m
        self.reach_m = mission.reach_m
        self.area_m = np.array(mission.area_m)
        self.start_m = np.array(mission.start_m)
        self.destination_m = np.array(mission.destination_m)
        self.threshold = mission.mse_threshold
        self.kappa = self.sensors * (1 - self.sensors * self.threshold)
        self.noise_w = mission.noise_power_w
        self.sensor_power_w = mission.sensor_power_max_w
        self.user_power_w = mission.user_power_max_w
        self.free_space_m2 = (SPEED_OF_LIGHT_MPS / (4 * np.pi * carrier_hz)) ** 2
        full = [max(self.quota, 1)] * self.users
        full += [mission.slot_rate_limit, self.threshold, *mission.area_m]
        self.full = np.array(full)
        self.reset()

    def reset(self) -> np.ndarray:
        self.position_m = self.start_m.copy()
        self.counts = np.zeros(self.users)
        self.slot, self.rate, self.mse = 0, 0.0, 0.0
        return self.observation()

    def observation(self) -> np.ndarray:
        state = np.concatenate([self.counts, [self.rate, self.mse], self.position_m])
        return ((state - self.full / 2) * (2 / self.full)).astype(np.float32)

    def gains(self) -> np.ndarray:
        offset = self.nodes_m - self.position_m
        distance_m = np.sqrt((offset**2).sum(axis=1) + self.altitude_m**2)
        elevation_deg = np.degrees(np.arcsin(self.altitude_m / distance_m))
        line_of_sight = 1 / (1 + 9.613 * np.exp(-0.158 * (elevation_deg - 9.613)))
        loss_db = 20.0 + (1.0 - 20.0) * line_of_sight
        return self.free_space_m2 / distance_m**2 * 10 ** (-loss_db / 10)

    def solve(self, sensor_gains: np.ndarray, user_gain: float) -> tuple[float, float, bool]:
        count = self.sensors
        a = np.sort(np.sqrt(self.sensor_power_w * sensor_gains / self.noise_w))
        below = np.concatenate([[0.0], np.cumsum(a)[:-1]])
        below_squared = np.concatenate([[0.0], np.cumsum(a * a)[:-1]])
        strong = count - np.arange(count)
        # The peak level: E = c A, in the first segment that contains its solution.
        sums = np.concatenate([below, [below[-1] + a[-1]]])[1:]
        squares = np.concatenate([below_squared, [below_squared[-1] + a[-1] ** 2]])[1:]
        levels = (1 + squares) / sums
        k = int(np.argmax(levels <= np.concatenate([a[1:], [np.inf]])))
        c = levels[k]
        amplitude = sums[k] + (count - k - 1) * c
        energy = 1 + squares[k] + (count - k - 1) * c * c
        efficiency = amplitude**2 / energy
        feasible = efficiency >= self.kappa
        signal = 0.0
        if feasible:
            budget = self.user_power_w * user_gain / self.noise_w
            affordable = (efficiency / self.kappa - 1) * energy
            signal = min(affordable, budget)
            if affordable > budget:
                at = below + strong * a
                energies = 1 + below_squared + strong * a * a
                reaches = (at**2 >= self.kappa * (budget + energies)) | (a >= c)
                k = int(np.argmax(reaches)) if reaches.any() else count - 1
                r, p, w = strong[k], below[k], below_squared[k]
                missing = (self.kappa * (budget + 1 + w) - p * p) / r
                c = missing / (p + np.sqrt(max(p * p + (r - self.kappa) * missing, 0)))
                amplitude = p + r * c
                energy = 1 + w + r * c * c
        eta = amplitude / (signal + energy)
        received = np.minimum(a, c)
        mse = (((eta * received - 1) ** 2).sum() + eta**2 * (signal + 1)) / count**2
        return float(np.log2(1 + signal / energy)), float(mse), bool(feasible)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool]:
        self.slot += 1
        displacement = action[:2].astype(float) * self.reach_m
        length = np.hypot(*displacement)
        if length > self.reach_m:
            displacement *= self.reach_m / length
        place = np.clip(self.position_m + displacement, 0, self.area_m)
        left_m = (self.slots - self.slot + 1) * self.reach_m
        away = place - self.destination_m
        distance = np.hypot(*away)
        if distance > left_m:
            place = self.destination_m + away * (left_m / distance)
        owed = np.maximum(self.quota - self.counts, 0)
        admissible = owed.sum() - (owed > 0) <= self.slots - self.slot
        user = int(np.argmax(np.where(admissible, action[2:], -np.inf)))
        self.position_m = place
        gains = self.gains()
        self.rate, self.mse, feasible = self.solve(
            gains[: self.sensors], gains[self.sensors + user]
        )
        self.counts[user] += 1
        last = self.slot == self.slots
        to_go_m = np.hypot(*(place - self.destination_m))
        arrived = last and to_go_m <= self.reach_m
        trajectory = 1e6 if arrived else -self.slot * to_go_m
        reward = (self.rate if feasible else 0.0) + 1e-6 * trajectory
        return self.observation(), reward, last
