"""The Gymnasium environment of one episode."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, SupportsFloat

import gymnasium
import numpy as np
import numpy.typing as npt

from . import core
from ._native import Mission
from .bounds import gap_of
from .missions import ScenarioLike
from .render import Map


class MissionEnv(gymnasium.Env[Any, Any]):
    """A mission, slot by slot.

    In each slot the vehicle flies a displacement and serves a user; powers and coefficients are
    then allocated optimally. An episode has as many slots as the mission and is then terminated.

    Args:
        scenario: A path, a name, a dictionary, a :class:`Random`, a :class:`Mission`, or a list of
            these: then each episode flies one of them, drawn at random.
        observation: ``paper``: the paper's state, counts per user, rate, MSE and position (M + 4
            numbers). ``sets``: a dictionary that describes any mission (the inputs of a policy
            file of format version 2, for up to 16 users and 64 sensors). ``flat``: the numbers of
            ``sets`` in one array.
        action: ``box``: the displacement in units of the largest one, east and north, and a score
            per user. ``hybrid``: the displacement, and a user. ``discrete``: a number,
            ``direction * users + user``; direction 0 hovers, the others fly as far as possible,
            counterclockwise from the east.
        normalize: Whether observations are scaled to about [-1, 1]. The default is ``True`` for
            ``paper`` and ``flat``, and ``False`` for ``sets``, whose raw units policy files expect.
        directions: The number of directions of ``discrete``.
        constraints: ``shielded``: a forbidden displacement or user is replaced by the nearest that
            is allowed, as in flight, so that every episode arrives and is fair. ``penalty``: the
            paper's form, where only area and speed are enforced.
        inner: How powers are chosen: ``exact``, ``alternating``, ``fixed-user-power[:WATTS]`` or
            ``fixed-sensor-power[:WATTS]``.
        rate_weight, trajectory_weight, arrival_reward: ``lambda_1``, ``lambda_2`` and ``R_f`` of
            the reward.
        bound: Whether ``info`` has the certified bound at the end of an episode, and what is
            missing to it. The bound of a mission is calculated once per process, at the end of its
            first episode, which mostly takes about a second. A float is the gap at which the
            calculation stops; ``True`` stands for 0.01.
        render_mode: ``None``, ``rgb_array`` or ``human``, a figure in a notebook.

    ``info`` after a step has ``rate`` (bit/s/Hz), ``mse``, ``feasible`` (the MSE threshold was
    met), ``reward_rate`` and ``reward_trajectory`` (the terms of the reward before they are
    weighted), ``user`` (that was served) and ``shielded`` (the action was changed); at the end
    also ``sum_rate``, ``arrived``, ``fair``, ``mse_violations``, ``interventions``, ``mission``
    and, with ``bound``, ``bound``, ``regret`` (bound less sum of rates) and ``share``.

    >>> env = MissionEnv(scenario="separated", action="hybrid")
    >>> observation, info = env.reset(seed=1)
    >>> observation, reward, terminated, truncated, info = env.step(([0.5, 0.5], 3))
    >>> info["user"], info["feasible"], terminated
    (3, True, False)
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array", "human"], "render_fps": 10}

    def __init__(
        self,
        scenario: ScenarioLike | Sequence[ScenarioLike] = "separated",
        observation: str = "paper",
        action: str = "box",
        *,
        normalize: bool | None = None,
        directions: int = 8,
        constraints: str = "shielded",
        inner: str = "exact",
        rate_weight: float = 1.0,
        trajectory_weight: float = 1e-6,
        arrival_reward: float = 1e6,
        bound: bool | float = False,
        render_mode: str | None = None,
    ) -> None:
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ValueError(f"render_mode is {render_mode!r}, but must be rgb_array or human")
        self._batch, self._missions = core.make_batch(
            1,
            "Disabled",
            scenario=scenario,
            observation=observation,
            action=action,
            normalize=normalize,
            directions=directions,
            constraints=constraints,
            inner=inner,
            rate_weight=rate_weight,
            trajectory_weight=trajectory_weight,
            arrival_reward=arrival_reward,
            threads=1,
        )
        self._gap = gap_of(bound)
        self._action = action
        # What `export_onnx` must know of the environment that a policy was trained with.
        self.policy_interface = core.policy_interface(observation, action, normalize)
        self.render_mode = render_mode
        self.observation_space = core.observation_space(self._batch, observation)
        self.action_space = core.action_space(self._batch, action, directions)
        self._arrays = core.Arrays(self._batch)
        self._shapes = [(1, *shape) for shape in self._batch.observation_shapes]
        self._map: Map | None = None
        self._is_reset = False

    @property
    def mission(self) -> Mission:
        """The mission of this episode."""
        return self._missions[int(self._batch.mission_indices()[0])]

    @property
    def position_m(self) -> tuple[float, float]:
        """The position of the vehicle, metres east and north."""
        east_m, north_m = self._batch.positions().tolist()
        return east_m, north_m

    def action_masks(self) -> npt.NDArray[np.bool_]:
        """Return which actions are admissible in the coming slot.

        An entry per action if they are discrete, as MaskablePPO expects, and otherwise per user.
        """
        masks = np.empty((1, self._batch.mask_length), np.bool_)
        self._batch.write_masks(masks)
        return masks[0]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode. The seed matters where there are several missions."""
        super().reset(seed=seed)
        seeds = None
        if seed is not None or not self._is_reset:
            seeds = self.np_random.integers(core.ENTROPY_MAX, size=1, dtype=np.uint64)
        self._is_reset = True
        arrays = core.observation_arrays(self._batch)
        self._batch.reset(arrays, None, seeds)
        if self.render_mode is not None:
            self._map = Map(self.mission)
            self._show()
        return core.as_observation([array[0] for array in arrays]), {}

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Fly a slot."""
        if not self._is_reset:
            raise gymnasium.error.ResetNeeded("call reset before the first step")
        first, second = self._as_arrays(action)
        arrays = [np.empty(shape, np.float32) for shape in self._shapes]
        a = self._arrays
        self._batch.step(first, second, arrays, a.rewards, a.terminated, a.terms, a.flags, a.users)
        rate, mse, reward_rate, reward_trajectory = a.terms[:, 0].tolist()
        feasible, shielded = a.flags[:, 0].tolist()
        info: dict[str, Any] = {
            "rate": rate,
            "mse": mse,
            "reward_rate": reward_rate,
            "reward_trajectory": reward_trajectory,
            "feasible": feasible,
            "shielded": shielded,
            "user": a.users.item(),
        }
        terminated = a.terminated.item()
        if terminated:
            self._add_summary(info)
        if self._map is not None:
            self._map.add(self.position_m, info["user"])
            self._show()
        observation = core.as_observation([array[0] for array in arrays])
        return observation, a.rewards.item(), terminated, False, info

    def _as_arrays(self, action: Any) -> tuple[Any, npt.NDArray[np.int64] | None]:
        if self._action == "box":
            return core.numbers(action, "action").reshape(1, -1), None
        if self._action == "hybrid":
            displacement, user = core.pair_of_actions(action)
            return (
                core.numbers(displacement, "action[0]").reshape(1, -1),
                core.integers(user, "action[1]").reshape(-1),
            )
        return core.integers(action, "action").reshape(-1), None

    def _add_summary(self, info: dict[str, Any]) -> None:
        for name, values in self._batch.summaries().items():
            info[name] = values.item()
        mission = self.mission
        info["mission"] = mission.name
        if self._gap is not None:
            upper = core.upper_bound(mission, self._gap)
            info["bound"] = upper
            info["regret"] = upper - info["sum_rate"]
            info["share"] = info["sum_rate"] / upper if upper > 0 else 1.0

    def render(self) -> npt.NDArray[np.uint8] | None:  # type: ignore[override]
        """Return the map as an array ``(height, width, 3)`` for ``rgb_array``."""
        if self.render_mode is None:
            gymnasium.logger.warn(
                "render() needs a render_mode, for example render_mode='rgb_array'"
            )
            return None
        if self._map is None:
            raise gymnasium.error.ResetNeeded("call reset before render")
        return self._map.draw() if self.render_mode == "rgb_array" else None

    def _show(self) -> None:
        if self.render_mode == "human" and self._map is not None:
            self._map.show()
