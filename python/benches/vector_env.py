"""Agent steps a second of the native vector environment, beside others: in `SyncVectorEnv`, by hand in NumPy, highway-env.

`RAYON_NUM_THREADS=1 taskset -c 0 python benches/vector_env.py [ENVIRONMENTS]`; times are the processor's, of the process.
highway-env is left out where it is not installed; one of its steps is one of its simulator, where crumple makes ten.
"""

import sys
import time
from importlib.util import find_spec

import gymnasium
import numpy as np
from gymnasium.vector import SyncVectorEnv
from numpy_platoon import NumpyPlatoon

import crumple
from crumple.env import PlatoonEnv, PlatoonVectorEnv


class Empty(gymnasium.Env):
    """Nothing at all: what stepping in Python costs."""

    observation_space = gymnasium.spaces.Box(-1.0, 1.0, (8,), np.float32)
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)
    state = np.zeros(8, np.float32)

    def reset(self, *, seed=None, options=None):
        """Begin nothing."""
        return self.state, {}

    def step(self, action):
        """Do nothing."""
        return self.state, 0.0, False, False, {}


def steps_a_second(env, steps):
    """The most of five measurements, with episodes that end and begin on the way."""
    random = np.random.default_rng(0)
    actions = random.uniform(-0.3, 0.3, (steps, env.num_envs, 1)).astype(np.float32)
    env.reset(seed=0)
    best = 0.0
    for _ in range(5):
        begun = time.process_time()
        for action in actions:
            env.step(action)
        best = max(best, steps * env.num_envs / (time.process_time() - begun))
    return best


class Flat(gymnasium.ActionWrapper):
    """An action as highway-env wants it."""

    def action(self, action):
        """The same."""
        return np.asarray(action, np.float32)


def highway():
    """One lane, three vehicles, the agent's acceleration, a decision every 0.1 s."""
    import highway_env

    gymnasium.register_envs(highway_env)
    action = {"type": "ContinuousAction", "longitudinal": True, "lateral": False}
    config = {"vehicles_count": 2, "lanes_count": 1, "simulation_frequency": 10, "policy_frequency": 10, "action": action}
    return Flat(gymnasium.make("highway-fast-v0", config=config))


def main():
    """Print a line for each."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 1024
    print(f"{count} environments, {len(crumple.space('paper').nominal())} vehicles, space `paper`, agent steps a second")
    for estimator in ("truth", "kalman"):
        native = steps_a_second(PlatoonVectorEnv(count, estimator=estimator, copy=False), 150)
        python = steps_a_second(SyncVectorEnv([lambda e=estimator: PlatoonEnv(estimator=e)] * count), 15)
        print(f"  {estimator:<7} native {native:>11,.0f}   SyncVectorEnv {python:>9,.0f}   ratio {native / python:.1f}")
    print(f"  by hand in NumPy {steps_a_second(NumpyPlatoon(count), 150):>9,.0f}")
    if find_spec("highway_env") is not None:
        print(f"  highway-env in SyncVectorEnv {steps_a_second(SyncVectorEnv([highway] * 8), 100):>9,.0f} (8 environments)")
    print(f"  an empty environment in SyncVectorEnv {steps_a_second(SyncVectorEnv([Empty] * count), 15):>9,.0f}")


main()
