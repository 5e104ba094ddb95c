"""Gymnasium environments: one vehicle of a line is driven by the agent, as in ``crumple train``.

An observation is the state that crumple's own policies see: the numbers of :data:`crumple.OBSERVATION`, scaled and cut as
the training preset says. An action from -1 to 1 is an acceleration (:attr:`PlatoonEnv.acceleration_range_mps2`), held for
:attr:`PlatoonEnv.decision_s`. A reward is what the preset pays, scaled as its learner sees it; at rest it includes the value
of standing still from then on.
"""

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import Any, ClassVar, TypeAlias

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from crumple._crumple import Episodes
from crumple._film import Film
from crumple._simulate import SpaceLike, space
from crumple.errors import TrainingError

State: TypeAlias = NDArray[np.float32]

ENDINGS = (None, "contact", "at-rest", "time-over")
"""Why an episode ended, by the number in a step's ``info["ending"]``; 0 for one that goes on."""

_STATE = 8
_MODES = {
    AutoresetMode.NEXT_STEP: "next-step",
    AutoresetMode.SAME_STEP: "same-step",
    AutoresetMode.DISABLED: "disabled",
}


def _spaces(episodes: Episodes) -> tuple[gymnasium.spaces.Box, gymnasium.spaces.Box]:
    limit = np.float32(episodes.state_limit)
    return (
        gymnasium.spaces.Box(-limit, limit, (_STATE,), np.float32),
        gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32),
    )


class _Buffers:
    """Where steps write."""

    def __init__(self, count: int) -> None:
        self.states = np.zeros((count, _STATE), np.float32)
        self.last_states = np.zeros((count, _STATE), np.float32)
        self.rewards = np.zeros(count, np.float32)
        self.terminated = np.zeros(count, np.bool_)
        self.truncated = np.zeros(count, np.bool_)
        self.endings = np.zeros(count, np.uint8)

    def step(self, episodes: Episodes, actions: Any) -> None:
        count = len(self.rewards)
        given = np.asarray(actions)
        if given.size != count or given.shape not in ((), (count,), (count, 1)) or given.dtype.kind not in "fiu":
            wanted = f"{count} numbers, in an array of shape ({count}, 1)"
            raise TrainingError(f"actions are {wanted}, found {given.dtype} of shape {given.shape}")
        # A copy: they may lie in an array that this step writes into.
        episodes.step(
            given.astype(np.float32).reshape(-1),
            self.states,
            self.last_states,
            self.rewards,
            self.terminated,
            self.truncated,
            self.endings,
        )


class PlatoonEnv(gymnasium.Env[State, NDArray[np.float32]]):
    """One episode after the other, each a draw of a space.

    ``space`` is a name, a path or a :class:`crumple.Space` in which vehicle 1 alone is under test; None for what the
    training ``preset`` (a name, a TOML file or its text) says. ``estimator`` replaces the preset's. With
    ``render_mode="rgb_array"`` :meth:`render` draws the line of vehicles from above, and below it the way of each over time.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 10}  # type: ignore[misc]

    def __init__(
        self,
        space: SpaceLike | None = "paper",
        preset: str = "fast",
        estimator: str | None = None,
        render_mode: str | None = None,
    ) -> None:
        self._episodes = _episodes(1, space, preset, estimator, "disabled")
        self._buffers = _Buffers(1)
        self._is_seeded = False
        if render_mode not in (None, "rgb_array"):
            raise TrainingError(f"render_mode is None or 'rgb_array', found {render_mode!r}")
        self.render_mode = render_mode
        self._film = Film() if render_mode == "rgb_array" else None
        spaces: tuple[Any, Any] = _spaces(self._episodes)
        self.observation_space, self.action_space = spaces
        self.decision_s = self._episodes.decision_s
        self.acceleration_range_mps2 = self._episodes.acceleration_range_mps2

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[State, dict[str, Any]]:
        """Begin an episode: the first draw of ``seed``, or the one after the last."""
        super().reset(seed=seed)
        if seed is None and not self._is_seeded:
            seed = int(self.np_random.integers(2**63))
        seeds = None if seed is None else [_seed(seed)]
        self._episodes.reset(seeds, np.ones(1, np.bool_), self._buffers.states)
        self._is_seeded = True
        if self._film is not None:
            self._film.begin()
            self._look(self._film)
        return self._buffers.states[0].copy(), {}

    def step(self, action: NDArray[np.float32]) -> tuple[State, float, bool, bool, dict[str, Any]]:
        """Hold an action until the next decision."""
        buffers = self._buffers
        buffers.step(self._episodes, action)
        if self._film is not None:
            self._look(self._film)
        return (
            buffers.states[0].copy(),
            float(buffers.rewards[0]),
            bool(buffers.terminated[0]),
            bool(buffers.truncated[0]),
            {"ending": int(buffers.endings[0])},
        )

    def render(self) -> NDArray[np.uint8] | None:
        """The line of vehicles and their ways so far, of shape (height, width, 3); None unless it was asked for."""
        return None if self._film is None else self._film.frame()

    def _look(self, film: Film) -> None:
        places = self._episodes.positions(0)
        if places is not None:
            film.add(self.decision_s, *places)


class PlatoonVectorEnv(VectorEnv[State, NDArray[np.float32], NDArray[Any]]):
    """Many episodes that step together, in Rust, on as many threads as ``RAYON_NUM_THREADS`` says.

    Environment i gives to the bit what a :class:`PlatoonEnv` with the same seed gives. Steps write into arrays of this
    object; with ``copy`` (the default) what is returned is the caller's to keep, without it the next step writes over it.
    ``autoreset_mode`` is Gymnasium's; with DISABLED, ``reset(options={"reset_mask": mask})`` resets those in the mask. With
    SAME_STEP the last states of episodes that ended are in ``info["final_obs"]``, valid where ``info["_final_obs"]``.
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
        self.num_envs = num_envs
        self.metadata = {"render_modes": [], "autoreset_mode": mode}
        self._episodes = _episodes(num_envs, space, preset, estimator, _MODES[mode])
        self._buffers = _Buffers(num_envs)
        self._mode = mode
        self._copies = copy
        self._is_seeded = False
        self.single_observation_space, self.single_action_space = _spaces(self._episodes)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.decision_s = self._episodes.decision_s
        self.acceleration_range_mps2 = self._episodes.acceleration_range_mps2

    def reset(
        self, *, seed: int | list[int | None] | list[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[State, dict[str, Any]]:
        """Begin episodes: of every environment, or of those in ``options["reset_mask"]``.

        With a number as ``seed``, environment i gets that number plus i; in a list there is one for each.
        """
        mask = np.ones(self.num_envs, np.bool_)
        if options is not None and "reset_mask" in options:
            mask = np.ascontiguousarray(options["reset_mask"])
            if mask.dtype != np.bool_ or mask.shape != (self.num_envs,):
                wanted = f"an array of bool of shape ({self.num_envs},)"
                raise TrainingError(f"reset_mask is {wanted}, found {mask.dtype} of shape {mask.shape}")
        if seed is None and not self._is_seeded:
            seed = int(self.np_random.integers(2**62))
        seeds: list[int] | None = None
        if isinstance(seed, Sequence | np.ndarray) and not isinstance(seed, str | bytes):
            seeds = [_seed(one) for one in seed]
            if len(seeds) != self.num_envs:
                raise TrainingError(f"there are {self.num_envs} environments, and {len(seeds)} seeds")
        elif seed is not None:
            seeds = [_seed(seed, index) for index in range(self.num_envs)]
        self._episodes.reset(seeds, mask, self._buffers.states)
        self._is_seeded = True
        return self._given(self._buffers.states), {}

    def step(
        self, actions: NDArray[np.float32]
    ) -> tuple[State, NDArray[Any], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Hold each action until the next decision."""
        buffers = self._buffers
        buffers.step(self._episodes, actions)
        info: dict[str, Any] = {"ending": self._given(buffers.endings)}
        if self._mode == AutoresetMode.SAME_STEP:
            ended = buffers.endings > 0
            if ended.any():
                info["final_obs"], info["_final_obs"] = self._given(buffers.last_states), ended
        return (
            self._given(buffers.states),
            self._given(buffers.rewards),
            self._given(buffers.terminated),
            self._given(buffers.truncated),
            info,
        )

    def _given(self, array: NDArray[Any]) -> NDArray[Any]:
        return array.copy() if self._copies else array


def _seed(seed: object, plus: int = 0) -> int:
    """A number that an environment can be seeded with."""
    try:
        number = operator.index(seed) + plus  # type: ignore[arg-type]
    except TypeError:
        number = -1
    if not 0 <= number < 2**64:
        raise TrainingError(f"a seed is a whole number from 0 to 2**64 - 1, found {seed!r}")
    return number


def _episodes(count: int, what: SpaceLike | None, preset: str, estimator: str | None, autoreset: str) -> Episodes:
    return Episodes(count, None if what is None else space(what), str(preset), estimator, autoreset)
