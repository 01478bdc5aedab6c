"""Policies: rules, planners, and trained ones from files."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _native
from ._native import Mission, Policy


class OnnxPolicy:
    """A trained policy in an ``.onnx`` file of the contract in ``docs/training.md``.

    It is evaluated by onnxruntime, which must be installed (``pip install onnxruntime``). Both
    format versions are supported: one mission (input ``observation``) and any mission (inputs
    ``mission``, ``users``, ``user_mask``, ``sensors`` and ``sensor_mask``).

    Args:
        path: The file.

    Raises:
        OSError: The file cannot be read.
        ValueError: It is no ONNX file of the contract.
        ImportError: onnxruntime is not installed.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        path = os.fspath(path)
        with open(path, "rb") as file:
            content = file.read()
        try:
            import onnxruntime
        except ImportError as error:
            raise ImportError(
                f"{path}: .onnx files need onnxruntime (pip install onnxruntime); `trainer convert "
                "F.onnx F.policy` writes a file that needs nothing"
            ) from error
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        options.log_severity_level = 4
        try:
            self._session = onnxruntime.InferenceSession(
                content, options, providers=["CPUExecutionProvider"]
            )
        except Exception as error:
            raise ValueError(f"{path}: {error}") from None
        self.path = path
        self.metadata: dict[str, str] = dict(self._session.get_modelmeta().custom_metadata_map)
        inputs = {entry.name for entry in self._session.get_inputs()}
        outputs = {entry.name for entry in self._session.get_outputs()}
        sets = {"mission", "users", "user_mask", "sensors", "sensor_mask"}
        if outputs != {"displacement", "user_scores"} or inputs not in ({"observation"}, sets):
            raise ValueError(
                f"{path}: inputs are {sorted(inputs)} and outputs {sorted(outputs)}, which is no "
                "policy of the contract in docs/training.md"
            )
        self.format_version = 1 if inputs == {"observation"} else 2

    @property
    def observation(self) -> str:
        """The observation that the policy takes: ``paper`` or ``sets``, in raw units."""
        return "paper" if self.format_version == 1 else "sets"

    def check(self, mission: Mission) -> None:
        """Check that the policy fits a mission.

        Raises:
            ValueError: It does not; the message has the value of the policy and of the mission.
        """
        if self.format_version != 1:
            return
        east_m, north_m = mission.area_m
        area = [float(number) for number in self.metadata["area_m"].replace(",", " ").split()]
        pairs = [
            ("users", float(self.metadata["users"]), mission.users),
            ("max_speed_mps", float(self.metadata["max_speed_mps"]), mission.max_speed_mps),
            ("slot_duration_s", float(self.metadata["slot_duration_s"]), mission.slot_duration_s),
            ("area_m[0]", area[0], east_m),
            ("area_m[1]", area[1], north_m),
        ]
        for what, ours, theirs in pairs:
            if not abs(ours - theirs) <= 1e-6 * abs(theirs):
                raise ValueError(
                    f"{self.path}: the policy is for {what} = {ours:g}, but the mission has "
                    f"{theirs:g}"
                )

    def __call__(self, observation: Any) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
        """Return the displacement in metres and a score per user."""
        arrays = observation if isinstance(observation, dict) else {"observation": observation}
        feed = {name: np.asarray(array, np.float32)[np.newaxis] for name, array in arrays.items()}
        displacement, scores = self._session.run(["displacement", "user_scores"], feed)
        return displacement[0], scores[0]

    def __repr__(self) -> str:
        return f"OnnxPolicy({self.path!r})"


def load_policy(policy: str | os.PathLike[str]) -> Policy | OnnxPolicy:
    """Load a policy.

    Args:
        policy: A name (``straight-line``, ``fixed``, ``plan``, ``search``, or ``any``, the shipped
            policy that flies any mission), or a file: ``.policy`` of format version 1 or 2, which
            is evaluated by the code of the microcontroller, or ``.onnx``, which is evaluated by
            onnxruntime if that is installed.

    Raises:
        OSError: The file cannot be read.
        ValueError: It is no policy, or no policy has the name.
        ImportError: It is an ``.onnx`` file, and onnxruntime is not installed.

    >>> load_policy("any")
    Policy("any")
    """
    name = os.fspath(policy)
    if not isinstance(name, str):
        raise TypeError(f"policy is {policy!r}, but must be a name or a path")
    if name.endswith(".onnx"):
        return OnnxPolicy(name)
    if name.endswith(".policy"):
        return _native.load_policy(name)
    return Policy.named(name)
