"""Environments, exact slot allocation, planner and certified bounds of aircomp_uav.

A UAV serves ground users and, in the same slots and on the same frequency, computes the average of
what ground sensors measure over the air. This package gives the controller that flies, in Rust, to
programs in Python:

* :class:`MissionEnv` and :class:`MissionVectorEnv`: Gymnasium environments, registered as
  ``aircomp_uav/Mission-v0``;
* :class:`Mission`, :class:`Random`: missions from files, names, dictionaries, or at random;
* :func:`solve_slots`: the exact power allocation of many slots;
* :func:`certified_bound`: what no mission can exceed, and a mission that comes close;
* :func:`benchmark`: a policy on many missions, as fractions of certified bounds;
* :func:`export_onnx`: trained policies as files that the vehicle flies;
* :class:`Planner`, :func:`load_policy`, :func:`fly`: plans, policies and flights.

>>> import gymnasium, aircomp_uav
>>> env = gymnasium.make("aircomp_uav/Mission-v0", scenario="separated")
>>> observation, info = env.reset(seed=1)
>>> observation.shape, env.action_space.shape
((19,), (17,))
"""

from __future__ import annotations

from ._native import SENSORS_MAX, SHIPPED, USERS_MAX, Mission, Planner, Policy, __version__
from ._register import ENVIRONMENT_ID, register
from .allocation import SlotSolutions, solve_slots
from .benchmark import BENCHMARK_MISSIONS, BenchmarkResult, benchmark
from .bounds import CertifiedBound, certified_bound
from .environment import MissionEnv
from .export import DenseLayer, export_onnx
from .flight import Flight, fly
from .missions import Random, load_mission
from .policies import OnnxPolicy, load_policy
from .vector import MissionVectorEnv

register()

__all__ = [
    "BENCHMARK_MISSIONS",
    "ENVIRONMENT_ID",
    "SENSORS_MAX",
    "SHIPPED",
    "USERS_MAX",
    "BenchmarkResult",
    "CertifiedBound",
    "DenseLayer",
    "Flight",
    "Mission",
    "MissionEnv",
    "MissionVectorEnv",
    "OnnxPolicy",
    "Planner",
    "Policy",
    "Random",
    "SlotSolutions",
    "__version__",
    "benchmark",
    "certified_bound",
    "export_onnx",
    "fly",
    "load_mission",
    "load_policy",
    "register",
    "solve_slots",
]
