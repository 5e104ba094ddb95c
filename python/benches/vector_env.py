"""Measures agent steps per second of the native vector environment, `SyncVectorEnv`, plain NumPy, and highway-env.

`RAYON_NUM_THREADS=1 taskset -c 0 python benches/vector_env.py [ENVIRONMENTS]` measures processor time of the process.
highway-env is optional; an agent step is one step of its simulator, and ten of crumple's.
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


class NoOpEnv(gymnasium.Env):
    """Environment that does nothing, to measure the overhead of Python."""

    observation_space = gymnasium.spaces.Box(-1.0, 1.0, (8,), np.float32)
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)
    state = np.zeros(8, np.float32)

    def reset(self, *, seed=None, options=None):
        """Returns a constant state."""
        return self.state, {}

    def step(self, action):
        """Returns a constant result."""
        return self.state, 0.0, False, False, {}


def steps_per_second(env, steps):
    """Returns the best of five measurements, resets included."""
    random = np.random.default_rng(0)
    actions = random.uniform(-0.3, 0.3, (steps, env.num_envs, 1)).astype(np.float32)
    env.reset(seed=0)
    best = 0.0
    for _ in range(5):
        start_s = time.process_time()
        for action in actions:
            env.step(action)
        best = max(best, steps * env.num_envs / (time.process_time() - start_s))
    return best


class FlattenAction(gymnasium.ActionWrapper):
    """Wrapper that converts an action for highway-env."""

    def action(self, action):
        """Returns the action as float32."""
        return np.asarray(action, np.float32)


def make_highway_env():
    """Returns highway-env with one lane, three vehicles, and a decision on acceleration every 0.1 s."""
    import highway_env

    gymnasium.register_envs(highway_env)
    action = {"type": "ContinuousAction", "longitudinal": True, "lateral": False}
    config = {
        "vehicles_count": 2,
        "lanes_count": 1,
        "simulation_frequency": 10,
        "policy_frequency": 10,
        "action": action,
    }
    return FlattenAction(gymnasium.make("highway-fast-v0", config=config))


def main():
    """Prints a line for each environment."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 1024
    print(
        f"{count} environments, {len(crumple.space('paper').nominal())} vehicles, space `paper`, agent steps a second"
    )
    for estimator in ("truth", "kalman"):
        native = steps_per_second(PlatoonVectorEnv(count, estimator=estimator, copy=False), 150)
        python = steps_per_second(SyncVectorEnv([lambda e=estimator: PlatoonEnv(estimator=e)] * count), 15)
        print(f"  {estimator:<7} native {native:>11,.0f}   SyncVectorEnv {python:>9,.0f}   ratio {native / python:.1f}")
    print(f"  by hand in NumPy {steps_per_second(NumpyPlatoon(count), 150):>9,.0f}")
    if find_spec("highway_env") is not None:
        highway = SyncVectorEnv([make_highway_env] * 8)
        print(f"  highway-env in SyncVectorEnv {steps_per_second(highway, 100):>9,.0f} (8 environments)")
    print(f"  an empty environment in SyncVectorEnv {steps_per_second(SyncVectorEnv([NoOpEnv] * count), 15):>9,.0f}")


main()
