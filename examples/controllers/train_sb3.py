"""Trains a model of Stable-Baselines3 to follow a vehicle, and saves it as a controller.

    python train_sb3.py follower.zip 20000
    crumple simulate paper-1 --controller follower.zip

Needs stable-baselines3. The model has crumple's eight inputs and an output from -1 to 1, so it needs no controller
file. docs/controllers.md describes the inputs, and how to choose other ones.
"""

import sys

import gymnasium
import numpy as np
from stable_baselines3 import SAC

OFFSET = np.array([16, 16, 12.5, 12.5, 12.5, 0, 0, 0], np.float32)
SCALE = np.array([16, 16, 12.5, 12.5, 12.5, 5, 5, 5], np.float32)
STEP_S = 0.1


class Follow(gymnasium.Env):
    """Environment of a vehicle whose leader speeds up and brakes at random, without a follower."""

    observation_space = gymnasium.spaces.Box(-4, 4, (8,), np.float32)
    action_space = gymnasium.spaces.Box(-1, 1, (1,), np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.gap, self.speed, self.ahead = self.np_random.uniform([10, 10, 10], [60, 30, 30])
        self.acceleration = self.ahead_acceleration = self.time = 0.0
        return self.observe(), {}

    def observe(self):
        x = [self.gap, 80, self.ahead, self.speed, self.speed, self.ahead_acceleration, self.acceleration, 0]
        return ((np.array(x, np.float32) - OFFSET) / SCALE).clip(-4, 4)

    def step(self, action):
        if self.np_random.random() < 0.03:
            self.ahead_acceleration = self.np_random.uniform(-6, 2)
        self.acceleration = -2.25 + 5.25 * float(action[0])
        before = self.ahead - self.speed
        self.ahead = np.clip(self.ahead + STEP_S * self.ahead_acceleration, 0, 35)
        self.speed = max(0.0, self.speed + STEP_S * self.acceleration)
        self.gap += STEP_S * 0.5 * (before + self.ahead - self.speed)
        self.time += STEP_S
        target_gap = 5 + 1.5 * self.speed
        reward = -abs(self.gap - target_gap) / 20 - 0.02 * self.acceleration**2 - (50 if self.gap <= 0 else 0)
        return self.observe(), reward, self.gap <= 0, self.time > 30, {}


model = SAC("MlpPolicy", Follow(), policy_kwargs={"net_arch": [64, 64]}, seed=0, learning_starts=100)
model.learn(int(sys.argv[2]))
model.save(sys.argv[1])
