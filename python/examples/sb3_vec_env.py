"""Adapter of crumple's vector environment for Stable-Baselines3."""

import numpy as np
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.vec_env import VecEnv

from crumple.env import PlatoonVectorEnv


class PlatoonVecEnv(VecEnv):
    """Vector environment of ``crumple/Platoon-v0`` for learners of Stable-Baselines3.

    ``settings`` are arguments of :class:`crumple.env.PlatoonVectorEnv`. An episode that reaches its time limit is
    truncated (``TimeLimit.truncated``), so that learners bootstrap the value of its last state.
    """

    def __init__(self, num_envs, **settings):
        self.inner = PlatoonVectorEnv(num_envs, autoreset_mode=AutoresetMode.SAME_STEP, **settings)
        self.actions = None
        self.returns, self.lengths = np.zeros(num_envs), np.zeros(num_envs, int)
        super().__init__(num_envs, self.inner.single_observation_space, self.inner.single_action_space)

    def reset(self):
        """Starts every episode, with the seeds of ``seed`` if it was called."""
        first = self._seeds[0]
        states, _ = self.inner.reset(seed=None if first is None else int(first))
        self._reset_seeds()
        self.returns[:], self.lengths[:] = 0.0, 0
        return states

    def step_async(self, actions):
        """Stores the actions for ``step_wait``."""
        self.actions = actions

    def step_wait(self):
        """Holds the actions until the next decision."""
        states, rewards, terminated, truncated, info = self.inner.step(self.actions)
        ended = terminated | truncated
        self.returns += rewards
        self.lengths += 1
        infos = [{} for _ in range(self.num_envs)]
        for index in np.flatnonzero(ended):
            infos[index] = {
                "terminal_observation": info["final_obs"][index],
                "TimeLimit.truncated": bool(truncated[index]),
                "episode": {"r": float(self.returns[index]), "l": int(self.lengths[index]), "t": 0.0},
            }
        self.returns[ended], self.lengths[ended] = 0.0, 0
        return states, rewards, ended, infos

    def close(self):
        """Closes the inner environment."""
        self.inner.close()

    def get_attr(self, attr_name, indices=None):
        """Returns the attribute of the inner environment for every environment."""
        return [getattr(self.inner, attr_name, None)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name, value, indices=None):
        """Raises an error, because the environments have no attributes of their own."""
        raise AttributeError(f"the environments have no `{attr_name}` of their own")

    def env_method(self, method_name, *method_args, indices=None, **method_kwargs):
        """Raises an error, because the environments have no methods of their own."""
        raise AttributeError(f"the environments have no `{method_name}` of their own")

    def env_is_wrapped(self, wrapper_class, indices=None):
        """Returns False for every environment."""
        return [False] * len(list(self._get_indices(indices)))
