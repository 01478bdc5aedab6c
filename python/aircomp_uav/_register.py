"""Registers the environment with Gymnasium, when the package is imported.

``gymnasium.make("aircomp_uav:aircomp_uav/Mission-v0")`` imports it by itself.
"""

from __future__ import annotations

ENVIRONMENT_ID = "aircomp_uav/Mission-v0"


def register() -> None:
    """Register ``aircomp_uav/Mission-v0``, unless it is registered already."""
    from gymnasium.envs.registration import register as register_environment
    from gymnasium.envs.registration import registry

    if ENVIRONMENT_ID not in registry:
        register_environment(
            id=ENVIRONMENT_ID,
            entry_point="aircomp_uav.environment:MissionEnv",
            vector_entry_point="aircomp_uav.vector:MissionVectorEnv",
        )
