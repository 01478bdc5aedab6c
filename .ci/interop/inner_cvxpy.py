"""Alg. 1 as a user of the paper would write it: eq:p_pbp in CVXPY, slots as JSON lines.

    inner_cvxpy.py SLOTS.jsonl RESULTS.jsonl [COUNT]

Dimensionless variables, the start at least MSE and the stop rule as in docs/mathematics.md. One
result line per slot (rate, feasible, failed, seconds, solves); exit code 1 if a result is better
than what the slot allows or breaks a constraint.
"""

import json
import math
import sys
import time

import cvxpy as cp
import numpy as np

XI = 1e-3
OUTER_MAX = 200
INNER_MAX = 500


def peak(a):
    """The amplitudes of least MSE: all y_j = min(c, a_j), the best c of a fine grid."""
    heard = a[a > 0]
    if heard.size == 0:
        return np.zeros_like(a)
    grid = np.geomspace(heard.min(), heard.max(), 4001)
    best = max(grid, key=lambda c: np.minimum(c, a).sum() ** 2 / (1 + (np.minimum(c, a) ** 2).sum()))
    return np.minimum(best, a)


def subproblem(sensors, share):
    """eq:p_pbp with eta, t and the bounds as parameters, built once per number of sensors."""
    x = cp.Variable(sensors, nonneg=True)
    z = cp.Variable(nonneg=True)
    psi = cp.Variable()
    x_max = cp.Parameter(sensors, nonneg=True)
    z_max = cp.Parameter(nonneg=True)
    noise = cp.Parameter(nonneg=True)
    t = cp.Parameter(nonneg=True)
    problem = cp.Problem(
        cp.Maximize(cp.log(z + psi) - t * psi),
        [
            cp.sum_squares(x - 1) + z + noise <= sensors * share,
            cp.sum_squares(x) + noise <= psi,
            x <= x_max,
            z <= z_max,
        ],
    )
    return problem, (x, z, psi), (x_max, z_max, noise, t)


def solve(slot):
    h2 = np.array(slot["sensor_gain"])
    sensors, noise = len(h2), slot["noise_power"]
    a = np.sqrt(slot["sensor_power_max"] * h2 / noise)
    budget = slot["user_power_max"] * (slot["user_gain"] or 0.0) / noise
    share = sensors * slot["mse_threshold"]
    kappa = sensors * (1 - share)
    y = peak(a)
    energy, total = 1 + (y**2).sum(), y.sum()
    if total**2 / energy < kappa:
        return dict(rate=0.0, feasible=False, failed=False, solves=0)
    problem, (x, z, psi), (x_max, z_max, noise_z, t) = subproblem(sensors, share)
    eta, q, solves, failed = total / energy, 0.0, 0, False
    for _ in range(OUTER_MAX):
        start = (eta * y, eta**2 * q, eta)
        x_max.value = np.minimum(eta * a, 2 + math.sqrt(sensors))
        z_max.value = min(eta**2 * budget, sensors)
        noise_z.value = eta**2
        psi_now, x_now, z_now = eta**2 * (1 + (y**2).sum()), eta * y, eta**2 * q
        for _ in range(INNER_MAX):
            t.value = 1 / psi_now
            try:
                problem.solve(solver=cp.CLARABEL)
            except cp.SolverError:
                failed = True
                break
            solves += 1
            if problem.status not in ("optimal", "optimal_inaccurate"):
                failed = True
                break
            moved = np.linalg.norm(np.append(x.value - x_now, z.value - z_now))
            x_now, z_now, psi_now = x.value, float(z.value), float(psi.value)
            slack = psi_now - (x_now**2).sum() - eta**2
            if moved <= XI and slack <= XI * psi_now:
                break
        if failed:
            break
        y = np.clip(x_now / eta, 0, a)
        total, energy = y.sum(), 1 + (y**2).sum()
        # The most that the MSE leaves for exactly these amplitudes.
        q = max(0.0, min(z_now / eta**2, budget, total**2 / kappa - energy))
        eta = total / (q + energy)
        moved = np.linalg.norm(
            np.append(eta * y - start[0], [eta**2 * q - start[1], (eta - start[2]) / eta])
        )
        if moved <= XI:
            break
    else:
        failed = True
    total, energy = y.sum(), 1 + (y**2).sum()
    mse = (((eta * y - 1) ** 2).sum() + eta**2 * (1 + q)) / sensors**2
    assert mse <= slot["mse_threshold"] * (1 + 1e-9), (mse, slot)
    rate = math.log2(1 + q / energy)
    assert rate <= -math.log2(1 - share) * (1 + 1e-9), (rate, slot)
    return dict(rate=rate, feasible=True, failed=failed, solves=solves)


def main():
    lines = open(sys.argv[1]).read().splitlines()
    count = int(sys.argv[3]) if len(sys.argv) > 3 else len(lines)
    with open(sys.argv[2], "w") as results:
        for line in lines[:count]:
            begun = time.perf_counter()
            result = solve(json.loads(line))
            result["seconds"] = time.perf_counter() - begun
            results.write(json.dumps(result) + "\n")


if __name__ == "__main__":
    main()
