"""Holds `host-sim solve` with error statistics against CVXPY on random slots.

usage: uncertain_cvxpy.py HOST_SIM [COUNT]

A slot whose channels are known up to errors is one second-order-cone problem (docs/mathematics.md,
section 10): in u = sqrt(v) y / n and tau = 1 / n, where n^2 = 1 + sum v y^2 is noise and
interference and r^2 = (1 + eps_g) q / n^2,

    maximise r   subject to   r <= sqrt((1 + eps_g) Q) tau,   sqrt(kappa) ||(1, r)|| <= sum rho / sqrt(v) u,
                              ||(tau, u)|| <= 1,   0 <= u <= sqrt(v) a tau.

Rates must agree to 1e-6 relative (2e-4 in single precision, of at least 0.05 bit/s/Hz), feasibility must be equal, and powers
and expected MSE, recomputed here, must keep their limits.
"""

import json
import math
import subprocess
import sys
import warnings

import cvxpy as cp
import numpy as np

HOST_SIM = sys.argv[1]
COUNT = int(sys.argv[2]) if len(sys.argv) > 2 else 1000
RATE = {"f64": 1e-6, "f32": 2e-4}
MSE = {"f64": 1e-9, "f32": 1e-5}
POWER = {"f64": 0.0, "f32": 1e-7}
# Nearer to the border of feasibility than this, rounding of single precision decides.
BORDER = {"f64": 0.0, "f32": 2e-5}
# bit/s/Hz; below, the error is relative to this: in single precision a smaller rate is a difference of
# numbers that are nearly equal.
SMALL_RATE = {"f64": 0.0, "f32": 0.05}
CLARABEL = dict(solver=cp.CLARABEL, tol_gap_abs=1e-10, tol_gap_rel=1e-10, tol_feas=1e-10)


def draw(random):
    """A slot with gains over up to eight orders, J from 1 to 40, errors of some or all sensors."""
    sensors = int(random.integers(1, 41))
    orders = random.choice([2, 4, 6, 8])

    def per_sensor(most):
        """A number for all, or a list; absent for known channels."""
        values = random.uniform(0, most, sensors) * (random.random(sensors) < 0.8)
        return [None, float(values[0]), values.tolist(), values.tolist()][random.integers(4)]

    slot = {
        "sensor_gain": (10 ** random.uniform(-12, orders - 12, sensors)).tolist(),
        "user_gain": 10 ** random.uniform(-12, -9),
        "sensor_power_max": 0.05,
        "user_power_max": 0.2,
        "noise_power": 3.162e-13,
        "mse_threshold": random.uniform(0.2, 0.95) / sensors,
        "sensor_error_variance": per_sensor(0.3),
        "sensor_phase_error_rad": per_sensor(0.8),
        "user_error_variance": [None, random.uniform(0, 0.3)][int(random.random() < 0.8)],
    }
    return {field: value for field, value in slot.items() if value is not None}


class Numbers:
    """A slot in units of the noise."""

    def __init__(self, slot):
        self.gain = np.array(slot["sensor_gain"])
        self.count = len(self.gain)
        self.noise = slot["noise_power"]
        self.variance = np.broadcast_to(slot.get("sensor_error_variance", 0.0), self.count)
        phase = np.broadcast_to(slot.get("sensor_phase_error_rad", 0.0), self.count)
        self.coherence = np.exp(-(phase**2) / 2)
        self.user_variance = slot.get("user_error_variance", 0.0)
        self.user_gain = slot["user_gain"]
        self.threshold = slot["mse_threshold"]
        self.amplitude = np.sqrt(slot["sensor_power_max"] * self.gain / self.noise)
        self.budget = slot["user_power_max"] * self.user_gain / self.noise

    def expected_mse(self, b, p, eta):
        y, q = b * np.sqrt(self.gain), p * self.user_gain
        sensors = 1 - 2 * self.coherence * eta * y + (1 + self.variance) * (eta * y) ** 2
        others = eta**2 * ((1 + self.user_variance) * q + self.noise)
        return (sensors.sum() + others) / self.count**2

    def feasible_rate(self, y):
        """The rate with these amplitudes, in units of the noise, and the power that the MSE allows."""
        y = np.clip(y, 0, self.amplitude)
        energy = 1 + ((1 + self.variance) * y**2).sum()
        kappa = self.count * (1 - self.count * self.threshold)
        room = (self.coherence @ y) ** 2 / kappa - energy
        q = min(self.budget, max(room, 0) / (1 + self.user_variance))
        return math.log2(1 + q / (energy + self.user_variance * q))

    def rate(self, b, p):
        y, q = b * np.sqrt(self.gain), p * self.user_gain
        noise = self.noise + ((1 + self.variance) * y**2).sum() + self.user_variance * q
        return math.log2(1 + q / noise)


def conic(slot):
    """Returns f / kappa - 1 and, if that is at least 0, the optimal rate.

    The rate is that of the better of the solver's two points, moved into its bounds, with the power
    that the MSE then allows: near the border of feasibility the objective is a difference that loses
    the solver's last digits. That it is close to this rate is checked.
    """
    x = Numbers(slot)
    kappa = x.count * (1 - x.count * x.threshold)
    v = 1 + x.variance
    u = cp.Variable(x.count, nonneg=True)
    tau = cp.Variable(nonneg=True)
    r = cp.Variable(nonneg=True)
    ball = [cp.norm(cp.hstack([tau, u])) <= 1, u <= cp.multiply(np.sqrt(v) * x.amplitude, tau)]
    aligned = cp.sum(cp.multiply(x.coherence / np.sqrt(v), u))
    most = cp.Problem(cp.Maximize(aligned), ball)
    most.solve(**CLARABEL)
    headroom = most.value**2 / kappa - 1
    if headroom < 0:
        return headroom, None
    at_most = x.feasible_rate(u.value / tau.value / np.sqrt(v))
    # In r / budget, so that a user who is hardly heard is not below the tolerance.
    budget = math.sqrt((1 + x.user_variance) * x.budget)
    accurate = math.sqrt(kappa) * cp.norm(cp.hstack([1.0, budget * r])) <= aligned
    best = cp.Problem(cp.Maximize(r), ball + [r <= tau, accurate])
    best.solve(**CLARABEL)
    s = (budget * r.value) ** 2
    objective = math.log2(1 + s / (1 + x.user_variance + x.user_variance * s))
    rate = max(at_most, x.feasible_rate(u.value / tau.value / np.sqrt(v)))
    assert abs(rate - objective) <= 1e-6 * rate + 1e-7, (slot, rate, objective)
    return headroom, rate


def main():
    # Clarabel says so where it misses 1e-10; what it found is checked.
    warnings.filterwarnings("ignore", "Solution may be inaccurate")
    random = np.random.default_rng(18)
    slots = [draw(random) for _ in range(COUNT)]
    text = "".join(json.dumps(slot) + "\n" for slot in slots)
    known = [conic(slot) for slot in slots]
    feasible = sum(rate is not None for _, rate in known)
    assert 0.5 * COUNT < feasible < COUNT or COUNT < 100, feasible
    for precision in ("f64", "f32"):
        solved = subprocess.run(
            [HOST_SIM, "solve", "--precision", precision],
            input=text, check=True, capture_output=True, text=True,
        )
        answers = [json.loads(line) for line in solved.stdout.splitlines()]
        assert len(answers) == COUNT, len(answers)
        worst_rate = worst_mse = 0.0
        at_border, strict = 0, []
        for number, (slot, (headroom, rate), answer) in enumerate(zip(slots, known, answers), 1):
            where = f"line {number}: {slot} {answer} {headroom} {rate}"
            assert "error" not in answer, where
            if abs(headroom) < BORDER[precision]:
                at_border += 1
                continue
            assert answer["feasible"] == (rate is not None), where
            b = np.array(answer["sensor_coefficients"])
            p, eta = answer["user_power"], answer["eta"]
            assert (b >= 0).all() and (b**2 <= slot["sensor_power_max"] * (1 + POWER[precision])).all(), where
            assert 0 <= p <= slot["user_power_max"] * (1 + POWER[precision]), where
            x = Numbers(slot)
            mse = x.expected_mse(b, p, eta)
            if rate is None:
                assert mse > slot["mse_threshold"], where
                continue
            worst_mse = max(worst_mse, mse / slot["mse_threshold"] - 1)
            for value in (answer["rate"], x.rate(b, p)):
                error = abs(value - rate)
                worst_rate = max(worst_rate, error / max(rate, SMALL_RATE[precision]))
                strict.append((error / rate, rate))
        print(f"{COUNT} slots with error statistics in {precision}, {feasible} feasible: rate within "
              f"{worst_rate:.1e} of CVXPY (limit {RATE[precision]:.0e}), expected MSE over the "
              f"threshold by at most {worst_mse:.1e} (limit {MSE[precision]:.0e}), {at_border} at the border")
        above = [rate for error, rate in strict if error > RATE[precision]]
        if above:
            print(f"  relative to the rate itself, {len(above)} of {len(strict)} rates are further "
                  f"away, the largest of them {max(above):.1e} bit/s/Hz")
        assert worst_rate <= RATE[precision]
        assert worst_mse <= MSE[precision]
        assert at_border <= COUNT // 100


if __name__ == "__main__":
    main()
