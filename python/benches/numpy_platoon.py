"""Vector environment of three vehicles in plain NumPy, as a reference for speed.

Simpler than crumple's: no noise, no filter, no time of collision within a step, uniform distributions, and no checks.
"""

import numpy as np

STEP_S, STEPS, LENGTH_M, LIMIT = 0.01, 10, 4.5, 4.0
OFFSET = np.array([16, 16, 12.5, 12.5, 12.5, 0, 0, 0])
SCALE = np.array([16, 16, 12.5, 12.5, 12.5, 5, 5, 5])


class NumpyPlatoon:
    """Leader that brakes from a random time on, the agent, and a follower whose emergency brake latches."""

    def __init__(self, num_envs):
        self.num_envs = num_envs

    def reset(self, seed=None):
        """Starts every episode."""
        self.random = np.random.default_rng(seed)
        shape = (self.num_envs, 3)
        self.position, self.speed, self.acceleration = np.zeros(shape), np.zeros(shape), np.zeros(shape)
        self.time, self.brakes_at, self.brakes_with = np.zeros((3, self.num_envs))
        self.fired = np.zeros(self.num_envs, bool)
        self.reset_masked(np.ones(self.num_envs, bool))
        return self.observe(), {}

    def reset_masked(self, mask):
        """Starts random episodes where ``mask`` is true."""
        count = int(mask.sum())
        gaps = self.random.uniform(12, 25, (count, 2))
        self.position[mask] = -np.cumsum(np.concatenate([np.zeros((count, 1)), gaps + LENGTH_M], axis=1), axis=1)
        self.speed[mask] = self.random.uniform(15, 30, (count, 1))
        self.acceleration[mask] = 0.0
        self.time[mask], self.fired[mask] = 0.0, False
        self.brakes_at[mask] = self.random.uniform(0, 5, count)
        self.brakes_with[mask] = self.random.uniform(2, 7, count)

    def observe(self):
        """Returns the scaled state."""
        gaps = self.position[:, :-1] - LENGTH_M - self.position[:, 1:]
        numbers = np.concatenate([gaps, self.speed, self.acceleration], axis=1)
        return ((numbers - OFFSET) / SCALE).clip(-LIMIT, LIMIT).astype(np.float32)

    def step(self, actions):
        """Makes ten steps of the simulator."""
        command = -2.25 + 5.25 * actions[:, 0]
        collided = np.zeros(self.num_envs, bool)
        for _ in range(STEPS):
            gaps = self.position[:, :-1] - LENGTH_M - self.position[:, 1:]
            closing = self.speed[:, 2] - self.speed[:, 1]
            self.fired |= (closing > 0) & (gaps[:, 1] < 1.5 * closing)
            self.acceleration[:, 0] = np.where(self.time >= self.brakes_at, -self.brakes_with, 0.0)
            self.acceleration[:, 1] = command
            self.acceleration[:, 2] = np.where(self.fired, -7.5, 0.0)
            speed = np.maximum(self.speed + STEP_S * self.acceleration, 0.0)
            self.position += 0.5 * STEP_S * (self.speed + speed)
            self.speed = speed
            self.time += STEP_S
            collided |= (self.position[:, :-1] - LENGTH_M <= self.position[:, 1:]).any(axis=1)
        rewards = np.where(collided, -20.0, 1.0)
        late = self.time >= 15.0
        states = self.observe()
        over = collided | late
        if over.any():
            self.reset_masked(over)
            states = self.observe()
        return states, rewards, collided, late, {}
