"""crumple's vector environment as one of Stable-Baselines3."""

import numpy as np
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.vec_env import VecEnv

from crumple.env import PlatoonVectorEnv


class PlatoonVecEnv(VecEnv):
    """Episodes of ``crumple/Platoon-v0`` side by side, for any learner of Stable-Baselines3.

    What is given beside the number of environments is given to :class:`crumple.env.PlatoonVectorEnv`. An episode that ended
    at the end of its time counts as cut off (``TimeLimit.truncated``), so that learners go on to value what would follow.
    """

    def __init__(self, num_envs, **settings):
        self.inner = PlatoonVectorEnv(num_envs, autoreset_mode=AutoresetMode.SAME_STEP, **settings)
        self.actions = None
        self.returns, self.lengths = np.zeros(num_envs), np.zeros(num_envs, int)
        super().__init__(num_envs, self.inner.single_observation_space, self.inner.single_action_space)

    def reset(self):
        """Begin every episode; seeds are those of ``seed``, if it was called."""
        first = self._seeds[0]
        states, _ = self.inner.reset(seed=None if first is None else int(first))
        self._reset_seeds()
        self.returns[:], self.lengths[:] = 0.0, 0
        return states

    def step_async(self, actions):
        """Keep the actions for ``step_wait``."""
        self.actions = actions

    def step_wait(self):
        """Hold the actions until the next decision."""
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
        """Nothing is open."""
        self.inner.close()

    def get_attr(self, attr_name, indices=None):
        """The same for every environment: they are one object."""
        return [getattr(self.inner, attr_name, None)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name, value, indices=None):
        """Refused: the environments have no attributes of their own."""
        raise AttributeError(f"the environments have no `{attr_name}` of their own")

    def env_method(self, method_name, *method_args, indices=None, **method_kwargs):
        """Refused: the environments have no methods of their own."""
        raise AttributeError(f"the environments have no `{method_name}` of their own")

    def env_is_wrapped(self, wrapper_class, indices=None):
        """None is."""
        return [False] * len(list(self._get_indices(indices)))
