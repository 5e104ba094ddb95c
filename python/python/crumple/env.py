"""Gymnasium environments in which the agent drives one vehicle of a platoon, as in ``crumple train``.

The observation is that of crumple's policies: the quantities of :data:`crumple.OBSERVATION`, scaled and clipped by the
training preset. An action in [-1, 1] is an acceleration (:attr:`PlatoonEnv.acceleration_range_mps2`), held for
:attr:`PlatoonEnv.decision_s`. The reward is that of the preset, scaled as for its learner; at rest it includes the
value of all further standstill.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, TypeAlias

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from crumple._crumple import Episodes
from crumple._numbers import whole_number
from crumple._renderer import EpisodeRenderer
from crumple._simulate import SpaceLike, space
from crumple.errors import TrainingError

State: TypeAlias = NDArray[np.float32]

ENDINGS = (None, "collision", "at-rest", "time-limit")
"""Endings of an episode by the index in ``info["ending"]``; 0 for an episode that continues."""

_AUTORESET_NAMES = {
    AutoresetMode.NEXT_STEP: "next-step",
    AutoresetMode.SAME_STEP: "same-step",
    AutoresetMode.DISABLED: "disabled",
}


def _make_spaces(episodes: Episodes) -> tuple[gymnasium.spaces.Box, gymnasium.spaces.Box]:
    limit = np.float32(episodes.state_limit)
    return (
        gymnasium.spaces.Box(-limit, limit, (episodes.state_width,), np.float32),
        gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32),
    )


class _StepBuffers:
    """Arrays with the results of a step."""

    def __init__(self, count: int, width: int) -> None:
        self.states = np.zeros((count, width), np.float32)
        self.last_states = np.zeros((count, width), np.float32)
        self.rewards = np.zeros(count, np.float32)
        self.terminated = np.zeros(count, np.bool_)
        self.truncated = np.zeros(count, np.bool_)
        self.endings = np.zeros(count, np.uint8)

    def step(self, episodes: Episodes, actions: Any) -> None:
        count = len(self.rewards)
        array = np.asarray(actions)
        if array.size != count or array.shape not in ((), (count,), (count, 1)) or array.dtype.kind not in "fiu":
            expected = f"{count} numbers, in an array of shape ({count}, 1)"
            raise TrainingError(f"actions are {expected}, found {array.dtype} of shape {array.shape}")
        # Copied, because the actions may be in an array that this step overwrites.
        episodes.step(
            array.astype(np.float32).reshape(-1),
            self.states,
            self.last_states,
            self.rewards,
            self.terminated,
            self.truncated,
            self.endings,
        )


class PlatoonEnv(gymnasium.Env[State, NDArray[np.float32]]):
    """Environment whose episodes are random scenarios of a space.

    ``space`` is a name, a path or a :class:`crumple.Space` in which only vehicle 1 is under test; None for the spaces
    of the training ``preset`` (a name, a TOML file or its text). ``estimator`` replaces that of the preset. With
    ``render_mode="rgb_array"`` :meth:`render` draws the vehicles from above, and below them their trajectories.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 10}  # type: ignore[misc]

    def __init__(
        self,
        space: SpaceLike | None = "paper",
        preset: str = "fast",
        estimator: str | None = None,
        render_mode: str | None = None,
    ) -> None:
        self._episodes = _make_episodes(1, space, preset, estimator, "disabled")
        self._buffers = _StepBuffers(1, self._episodes.state_width)
        self._is_seeded = False
        if render_mode not in (None, "rgb_array"):
            raise TrainingError(f"render_mode is None or 'rgb_array', found {render_mode!r}")
        self.render_mode = render_mode
        self._renderer = EpisodeRenderer() if render_mode == "rgb_array" else None
        spaces: tuple[Any, Any] = _make_spaces(self._episodes)
        self.observation_space, self.action_space = spaces
        self.decision_s = self._episodes.decision_s
        self.acceleration_range_mps2 = self._episodes.acceleration_range_mps2

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[State, dict[str, Any]]:
        """Starts an episode: the first random scenario of ``seed``, or the next one."""
        super().reset(seed=seed)
        if seed is None and not self._is_seeded:
            seed = int(self.np_random.integers(2**63))
        seeds = [None if seed is None else _parse_seed(seed)]
        self._episodes.reset(seeds, np.ones(1, np.bool_), self._buffers.states)
        self._is_seeded = True
        if self._renderer is not None:
            self._renderer.reset()
            self._record_positions(self._renderer)
        return self._buffers.states[0].copy(), {}

    def step(self, action: NDArray[np.float32]) -> tuple[State, float, bool, bool, dict[str, Any]]:
        """Holds an action until the next decision."""
        buffers = self._buffers
        buffers.step(self._episodes, action)
        if self._renderer is not None:
            self._record_positions(self._renderer)
        return (
            buffers.states[0].copy(),
            float(buffers.rewards[0]),
            bool(buffers.terminated[0]),
            bool(buffers.truncated[0]),
            {"ending": int(buffers.endings[0])},
        )

    def render(self) -> NDArray[np.uint8] | None:
        """Returns an image of the episode, of shape (height, width, 3); None without ``render_mode``."""
        return None if self._renderer is None else self._renderer.render()

    def _record_positions(self, renderer: EpisodeRenderer) -> None:
        places = self._episodes.positions(0)
        if places is not None:
            renderer.add_positions(self.decision_s, *places)


class PlatoonVectorEnv(VectorEnv[State, NDArray[np.float32], NDArray[Any]]):
    """Vector environment whose episodes step together, in Rust, on as many threads as other work.

    Environment i returns exactly the results of a :class:`PlatoonEnv` with the same seed. With ``copy`` (the default)
    the returned arrays are copies; without it the next step overwrites them. ``autoreset_mode`` is that of Gymnasium.
    With DISABLED, ``reset(options={"reset_mask": mask})`` resets the environments in the mask. With SAME_STEP the last
    states of episodes that ended are in ``info["final_obs"]``, valid where ``info["_final_obs"]`` is true.
    """

    def __init__(
        self,
        num_envs: int = 1,
        space: SpaceLike | None = "paper",
        preset: str = "fast",
        estimator: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        copy: bool = True,
    ) -> None:
        mode = AutoresetMode(autoreset_mode)
        num_envs = whole_number("num_envs", num_envs, 1, 2**20, TrainingError)
        self.num_envs = num_envs
        self.metadata = {"render_modes": [], "autoreset_mode": mode}
        self._episodes = _make_episodes(num_envs, space, preset, estimator, _AUTORESET_NAMES[mode])
        self._buffers = _StepBuffers(num_envs, self._episodes.state_width)
        self._autoreset_mode = mode
        self._copy = copy
        self._is_seeded = np.zeros(num_envs, np.bool_)
        self.single_observation_space, self.single_action_space = _make_spaces(self._episodes)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.decision_s = self._episodes.decision_s
        self.acceleration_range_mps2 = self._episodes.acceleration_range_mps2

    def reset(
        self, *, seed: int | list[int | None] | list[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[State, dict[str, Any]]:
        """Starts episodes in every environment, or in those of ``options["reset_mask"]``.

        ``seed`` is a list with a seed for each environment, or a number to which environment i adds i. An environment
        without a seed, or with the seed None, continues its sequence of scenarios; its first one is random.
        """
        mask = np.ones(self.num_envs, np.bool_)
        if options is not None and "reset_mask" in options:
            mask = np.ascontiguousarray(options["reset_mask"])
            if mask.dtype != np.bool_ or mask.shape != (self.num_envs,):
                expected = f"an array of bool of shape ({self.num_envs},)"
                raise TrainingError(f"reset_mask is {expected}, found {mask.dtype} of shape {mask.shape}")
        seeds: list[int | None] = [None] * self.num_envs
        if isinstance(seed, Sequence | np.ndarray) and not isinstance(seed, str | bytes):
            seeds = [None if one is None else _parse_seed(one) for one in seed]
            if len(seeds) != self.num_envs:
                problem = f"must have a seed for each of {self.num_envs} environments, found {len(seeds)}"
                raise TrainingError(f"seed: {problem}", field="seed")
        elif seed is not None:
            seeds = [_parse_seed(seed, index) for index in range(self.num_envs)]
        unseeded = [index for index in np.flatnonzero(mask & ~self._is_seeded) if seeds[index] is None]
        if unseeded:
            first = int(self.np_random.integers(2**62))
            for index in unseeded:
                seeds[index] = first + int(index)
        self._episodes.reset(seeds, mask, self._buffers.states)
        self._is_seeded |= mask
        return self._output(self._buffers.states), {}

    def step(
        self, actions: NDArray[np.float32]
    ) -> tuple[State, NDArray[Any], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Holds each action until the next decision."""
        buffers = self._buffers
        buffers.step(self._episodes, actions)
        info: dict[str, Any] = {"ending": self._output(buffers.endings)}
        if self._autoreset_mode == AutoresetMode.SAME_STEP:
            ended = buffers.endings > 0
            if ended.any():
                info["final_obs"], info["_final_obs"] = self._output(buffers.last_states), ended
        return (
            self._output(buffers.states),
            self._output(buffers.rewards),
            self._output(buffers.terminated),
            self._output(buffers.truncated),
            info,
        )

    def _output(self, array: NDArray[Any]) -> NDArray[Any]:
        return array.copy() if self._copy else array


def _parse_seed(seed: object, offset: int = 0) -> int:
    """Returns the argument ``seed`` plus ``offset``, which must be a valid seed, too."""
    return whole_number("seed", seed, 0, 2**64 - 1 - offset, TrainingError) + offset


def _make_episodes(
    count: int, source: SpaceLike | None, preset: str, estimator: str | None, autoreset: str
) -> Episodes:
    return Episodes(count, None if source is None else space(source), str(preset), estimator, autoreset)
