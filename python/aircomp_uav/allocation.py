"""The exact power allocation of many slots."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from . import _native

LIMITED_BY = ("none", "accuracy", "power")


@dataclass(frozen=True, eq=False)
class SlotSolutions:
    """The optimal solutions of ``n`` slots.

    Attributes:
        rate: bit/s/Hz, ``(n,)``.
        mse: The MSE of the average with these powers, ``(n,)``.
        feasible: Whether ``mse_threshold`` can be met; if not, the user is silent and ``mse`` is
            the least MSE.
        limited_by: What limits the rate: an index into ``LIMITED_BY`` (none, accuracy, power).
        user_power_w: The power of the user, watts.
        sensor_coefficients: The transmit amplitude of each sensor, square root of watts, ``(n, J)``.
        normalizing_factor: ``eta``.
        least_mse: The least MSE that the channels allow with the user silent.
    """

    rate: npt.NDArray[np.float64]
    mse: npt.NDArray[np.float64]
    feasible: npt.NDArray[np.bool_]
    limited_by: npt.NDArray[np.uint8]
    user_power_w: npt.NDArray[np.float64]
    sensor_coefficients: npt.NDArray[np.float64]
    normalizing_factor: npt.NDArray[np.float64]
    least_mse: npt.NDArray[np.float64]


def solve_slots(
    sensor_gains: npt.ArrayLike,
    user_gains: npt.ArrayLike,
    *,
    sensor_power_max_w: npt.ArrayLike,
    user_power_max_w: npt.ArrayLike,
    noise_power_w: npt.ArrayLike,
    mse_threshold: npt.ArrayLike,
    threads: int | None = None,
) -> SlotSolutions:
    """Solve slots to the global optimum, in closed form.

    Args:
        sensor_gains: Power gains ``|h_j|^2``, ``(n, J)``.
        user_gains: Power gains ``|g|^2`` of the served user, ``(n,)``; 0 if nobody is served.
        sensor_power_max_w, user_power_max_w, noise_power_w, mse_threshold: Numbers, or arrays with
            one per slot.
        threads: The number of threads; by default all.

    Raises:
        ValueError: A shape or a number is wrong; the message names the slot and the number.

    >>> slots = solve_slots([[4e-12] * 36], [2e-12], sensor_power_max_w=0.05, user_power_max_w=0.2,
    ...                     noise_power_w=10**-12.5, mse_threshold=0.015)
    >>> bool(slots.feasible[0]), round(float(slots.rate[0]), 4)
    (True, 0.5178)
    """
    gains = np.ascontiguousarray(_real(sensor_gains, "sensor_gains"))
    if gains.ndim != 2:
        raise ValueError(f"sensor_gains has the shape {gains.shape}, but must have (n, J)")
    count = gains.shape[0]
    users = np.ascontiguousarray(_real(user_gains, "user_gains"))
    limits = np.empty((count, 4))
    columns = {
        "sensor_power_max_w": sensor_power_max_w,
        "user_power_max_w": user_power_max_w,
        "noise_power_w": noise_power_w,
        "mse_threshold": mse_threshold,
    }
    for index, (name, values) in enumerate(columns.items()):
        column = _real(values, name)
        if column.shape not in ((), (count,)):
            raise ValueError(f"{name} has the shape {column.shape}, but must have () or ({count},)")
        limits[:, index] = column
    return SlotSolutions(**_native.solve_slots(gains, users, limits, threads))


def _real(values: npt.ArrayLike, name: str) -> npt.NDArray[np.float64]:
    """Return real numbers in double precision."""
    try:
        array = np.asarray(values)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    if array.dtype.kind not in "iufb":
        raise TypeError(f"{name} has the type {array.dtype}, but must have real numbers")
    return array.astype(np.float64, copy=False)
