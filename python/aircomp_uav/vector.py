"""The vectorized Gymnasium environment: all episodes are stepped by one call in Rust."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from . import core
from ._native import Mission
from .bounds import gap_of
from .missions import ScenarioLike
from .render import Map


class MissionVectorEnv(VectorEnv[Any, Any, Any]):
    """Many episodes of missions, stepped together.

    The arguments are those of :class:`MissionEnv`, and

    Args:
        num_envs: The number of episodes.
        autoreset_mode: What happens at the end of an episode, see Gymnasium's ``AutoresetMode``;
            ``metadata["autoreset_mode"]`` says it to others. ``NextStep``: the next step ignores
            the action and starts an episode. ``SameStep``: the last step returns the first
            observation of the next episode, and ``infos`` has ``final_obs`` and ``final_info``.
            ``Disabled``: call ``reset(options={"reset_mask": terminated})``.
        copy: Whether every step returns new arrays. With ``False`` the arrays of the last step are
            written again, which saves their allocation.
        threads: The number of threads; by default all. The numbers do not depend on it.

    >>> envs = MissionVectorEnv(num_envs=3, scenario="separated")
    >>> observations, infos = envs.reset(seed=1)
    >>> observations.shape, envs.action_space.shape
    ((3, 19), (3, 17))
    >>> observations, rewards, terminated, truncated, infos = envs.step(envs.action_space.sample())
    >>> rewards.shape, infos["rate"].shape
    ((3,), (3,))
    """

    def __init__(
        self,
        num_envs: int = 1,
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
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        copy: bool = True,
        threads: int | None = None,
    ) -> None:
        super().__init__()
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode is {render_mode!r}, but must be None or rgb_array")
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self._batch, self._missions = core.make_batch(
            num_envs,
            self.autoreset_mode.value,
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
            threads=threads,
        )
        self._gap = gap_of(bound)
        self._action = action
        self._copy = copy
        self.num_envs = num_envs
        self.render_mode = render_mode
        self.metadata = {
            "render_modes": ["rgb_array"],
            "render_fps": 10,
            "autoreset_mode": self.autoreset_mode,
        }
        self.single_observation_space = core.observation_space(self._batch, observation)
        self.single_action_space = core.action_space(self._batch, action, directions)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._shapes = [(num_envs, *shape) for shape in self._batch.observation_shapes]
        self._observation = core.observation_arrays(self._batch)
        self._arrays = core.Arrays(self._batch)
        self._final = (
            core.observation_arrays(self._batch)
            if self.autoreset_mode is AutoresetMode.SAME_STEP
            else None
        )
        self._truncated = np.zeros(num_envs, np.bool_)
        self._all = np.ones(num_envs, np.bool_)
        self._all.flags.writeable = False
        self._restarted = np.zeros(num_envs, np.bool_)
        self._is_reset = False
        self._maps: list[Map] | None = None

    @property
    def missions(self) -> list[Mission]:
        """The mission of each episode."""
        return [self._missions[index] for index in self._batch.mission_indices().tolist()]

    @property
    def positions_m(self) -> npt.NDArray[np.float64]:
        """The positions of the vehicles, metres east and north, ``(num_envs, 2)``."""
        return self._batch.positions().reshape(-1, 2)

    def action_masks(self) -> npt.NDArray[np.bool_]:
        """Return which actions, or users, are admissible in the coming slot, a row per episode."""
        masks = np.empty((self.num_envs, self._batch.mask_length), np.bool_)
        self._batch.write_masks(masks)
        return masks

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Any, dict[str, Any]]:
        """Start all episodes, or those of ``options["reset_mask"]``."""
        mask = None if options is None else options.get("reset_mask")
        if mask is not None:
            mask = self._checked_mask(mask)
            if not self._is_reset:
                raise gymnasium.error.ResetNeeded("call reset without reset_mask first")
        seeds = self._seeds(seed, mask)
        if self._copy:
            self._observation = [array.copy() for array in self._observation]
        self._batch.reset(self._observation, mask, seeds)
        if mask is None:
            self._restarted = np.zeros(self.num_envs, np.bool_)
        else:
            self._restarted = self._restarted & ~mask
        self._is_reset = True
        if self.render_mode is not None:
            old = self._maps
            self._maps = [
                Map(mission) if old is None or mask is None or mask[index] else old[index]
                for index, mission in enumerate(self.missions)
            ]
        return core.as_observation(self._observation), {}

    def step(
        self, actions: Any
    ) -> tuple[
        Any,
        npt.NDArray[np.float64],
        npt.NDArray[np.bool_],
        npt.NDArray[np.bool_],
        dict[str, Any],
    ]:
        """Fly a slot in every episode."""
        if not self._is_reset:
            raise gymnasium.error.ResetNeeded("call reset before the first step")
        first: Any
        second: npt.NDArray[np.int64] | None = None
        if self._action == "box":
            first = core.numbers(actions, "actions")
        elif self._action == "hybrid":
            displacements, users = core.pair_of_actions(actions)
            first = core.numbers(displacements, "actions[0]")
            second = core.integers(users, "actions[1]")
        else:
            first = core.integers(actions, "actions")
        arrays, observation = self._arrays, self._observation
        if self._copy:
            arrays = core.Arrays(self._batch)
            observation = [np.empty(shape, np.float32) for shape in self._shapes]
        ended = self._batch.step(
            first,
            second,
            observation,
            arrays.rewards,
            arrays.terminated,
            arrays.terms,
            arrays.flags,
            arrays.users,
            self._final,
        )
        self._observation = observation
        infos = self._infos(arrays, ended)
        if self._maps is not None:
            self._extend_maps(arrays)
        if self.autoreset_mode is AutoresetMode.NEXT_STEP:
            self._restarted = arrays.terminated.copy() if ended else self._no_restart
        truncated = self._truncated.copy() if self._copy else self._truncated
        return (
            core.as_observation(observation),
            arrays.rewards,
            arrays.terminated,
            truncated,
            infos,
        )

    @property
    def _no_restart(self) -> npt.NDArray[np.bool_]:
        return self._truncated

    def _infos(self, arrays: core.Arrays, ended: int) -> dict[str, Any]:
        # Every quantity has a mask beside it, which says which episodes it is of.
        flown = self._all
        if self.autoreset_mode is AutoresetMode.NEXT_STEP and self._restarted.any():
            flown = ~self._restarted
        terms, flags = arrays.terms, arrays.flags
        infos: dict[str, Any] = {
            "rate": terms[0],
            "mse": terms[1],
            "reward_rate": terms[2],
            "reward_trajectory": terms[3],
            "feasible": flags[0],
            "shielded": flags[1],
            "user": arrays.users,
            "_rate": flown,
            "_mse": flown,
            "_reward_rate": flown,
            "_reward_trajectory": flown,
            "_feasible": flown,
            "_shielded": flown,
            "_user": flown,
        }
        if ended:
            ending = arrays.terminated.copy()
            summary = self._summary(ending)
            if self.autoreset_mode is AutoresetMode.SAME_STEP:
                self._add_final(infos, summary, ending)
            else:
                infos.update(summary)
        return infos

    def _summary(self, ending: npt.NDArray[np.bool_]) -> dict[str, Any]:
        summary: dict[str, Any] = dict(self._batch.summaries())
        indices = summary["mission"]
        names = np.array([mission.name for mission in self._missions], dtype=object)
        summary["mission"] = names[indices]
        if self._gap is not None:
            upper = np.zeros(self.num_envs)
            for index in np.unique(indices[ending]).tolist():
                upper[indices == index] = core.upper_bound(self._missions[index], self._gap)
            summary["bound"] = upper
            summary["regret"] = upper - summary["sum_rate"]
            share = np.ones(self.num_envs)
            np.divide(summary["sum_rate"], upper, out=share, where=upper > 0)
            summary["share"] = share
        for name in list(summary):
            values = summary[name]
            values[~ending] = None if values.dtype == object else 0
            summary[f"_{name}"] = ending
        return summary

    def _add_final(
        self, infos: dict[str, Any], summary: dict[str, Any], ending: npt.NDArray[np.bool_]
    ) -> None:
        assert self._final is not None
        final_obs = np.full(self.num_envs, None, dtype=object)
        for index in np.flatnonzero(ending).tolist():
            parts = [array[index].copy() for array in self._final]
            final_obs[index] = core.as_observation(parts)
        final_info = {name: values for name, values in infos.items() if not name.startswith("_")}
        final_info.update({f"_{name}": ending for name in final_info})
        final_info.update(summary)
        # As in Gymnasium: the infos of this step are of the episodes that go on.
        going_on = ~ending
        infos.update({name: going_on for name in infos if name.startswith("_")})
        infos["final_obs"], infos["_final_obs"] = final_obs, ending
        infos["final_info"], infos["_final_info"] = final_info, ending

    def _checked_mask(self, mask: Any) -> npt.NDArray[np.bool_]:
        if not isinstance(mask, np.ndarray):
            raise TypeError(f"reset_mask must be a NumPy array, got {type(mask).__name__}")
        if mask.shape != (self.num_envs,):
            raise ValueError(f"reset_mask must have the shape ({self.num_envs},), got {mask.shape}")
        if mask.dtype != np.bool_:
            raise TypeError(f"reset_mask must have the type bool, got {mask.dtype}")
        if not mask.any():
            raise ValueError("reset_mask must have at least one entry that is True")
        return np.ascontiguousarray(mask)

    def _seeds(
        self, seed: int | Sequence[int | None] | None, mask: npt.NDArray[np.bool_] | None
    ) -> npt.NDArray[np.uint64] | None:
        """Return the seed of every episode's choice of missions, or ``None`` to go on as it is."""
        if seed is None and self._is_reset:
            return None
        if seed is None or isinstance(seed, (int, np.integer)):
            if seed is not None:
                self._np_random, self._np_random_seed = gymnasium.utils.seeding.np_random(int(seed))
            return self.np_random.integers(
                core.ENTROPY_MAX, size=self.num_envs, dtype=np.uint64
            )
        if len(seed) != self.num_envs:
            raise ValueError(f"there are {len(seed)} seeds, but must be {self.num_envs}")
        # As Gymnasium does: each episode has a generator of its own.
        generators = [gymnasium.utils.seeding.np_random(one)[0] for one in seed]
        return np.array(
            [one.integers(core.ENTROPY_MAX, dtype=np.uint64) for one in generators], np.uint64
        )

    def _extend_maps(self, arrays: core.Arrays) -> None:
        assert self._maps is not None
        slots_done = self._batch.slots_done().tolist()
        for index, (position, user) in enumerate(
            zip(self.positions_m.tolist(), arrays.users.tolist(), strict=True)
        ):
            if slots_done[index] == 0:
                mission = self._missions[int(self._batch.mission_indices()[index])]
                self._maps[index] = Map(mission)
            else:
                self._maps[index].add(tuple(position), user)

    def render(self) -> tuple[npt.NDArray[np.uint8], ...] | None:
        """Return the map of every episode for ``rgb_array``."""
        if self.render_mode is None:
            gymnasium.logger.warn(
                "render() needs a render_mode, for example render_mode='rgb_array'"
            )
            return None
        if self._maps is None:
            raise gymnasium.error.ResetNeeded("call reset before render")
        return tuple(drawn.draw() for drawn in self._maps)
