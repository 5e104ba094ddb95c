#!/usr/bin/env python3
"""Compares the speed of crumple with SUMO and Stable-Baselines3 on the same tasks, with one thread each.

This program is not part of the build. It needs Python 3.10 or later and, from PyPI:

    pip install libsumo==1.28.0 stable-baselines3==2.9.2

(Stable-Baselines3 brings PyTorch.) Then, from the root of the repository:

    python benches/compare.py

Rollouts: the paper's first scenario, three vehicles for 1500 steps of 0.01 s. The leader holds 25 m/s for 1 s and
then brakes at 3 m/s² to standstill; the other two follow with the Intelligent Driver Model and the same parameters.
SUMO is timed twice: with a simulation loaded for each scenario, as in a tool that varies scenarios, and in its fastest
way, with one simulation into which vehicles are inserted and from which they are removed. Its start is not counted.

Training: DDPG with an observation of eight numbers, one acceleration as action and an update after each decision. Its
environment has the same three vehicles, in plain Python for Stable-Baselines3. Its time (about 10 µs a step) counts.

Each figure is a mean over many scenarios or decisions. The time of a scenario includes its preparation: SUMO inserts
and removes vehicles (and loads a network, in the first line); crumple edits, checks and prepares a scenario.

All times are processor times of one thread, so that a busy machine changes them little.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

# Set before importing libraries that start threads.
for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[name] = "1"

ROOT = Path(__file__).resolve().parent.parent
STEP_S, STEPS, ONSET_S = 0.01, 1500, 1.0
SPEED_MPS, LEAD_BRAKE_MPS2, GAP_M, LENGTH_M = 25.0, 3.0, 16.0, 2.0
# Defaults of crumple's `idm`.
IDM = {"desired": 120 / 3.6, "headway": 1.6, "standstill": 2.0, "accel": 0.73, "brake": 1.67}

NETWORK = """<net version="1.16">
  <location netOffset="0,0" convBoundary="0,0,5000,0" origBoundary="0,0,5000,0" projParameter="!"/>
  <edge id="road" from="a" to="b" priority="1">
    <lane id="road_0" index="0" speed="60" length="5000" shape="0,0 5000,0"/>
  </edge>
  <junction id="a" type="dead_end" x="0" y="0" incLanes="" intLanes="" shape="0,0 0,-3.2"/>
  <junction id="b" type="dead_end" x="5000" y="0" incLanes="road_0" intLanes="" shape="5000,-3.2 5000,0"/>
</net>
"""
ROUTES = f"""<routes>
  <vType id="car" carFollowModel="IDM" length="{LENGTH_M}" minGap="{IDM["standstill"]}" tau="{IDM["headway"]}"
         accel="{IDM["accel"]}" decel="{IDM["brake"]}" emergencyDecel="9" maxSpeed="{IDM["desired"]}" sigma="0"
         speedFactor="1" actionStepLength="{STEP_S}"/>
  <route id="along" edges="road"/>
</routes>
"""


def sumo_scenarios_per_s(count, load_each):
    """Measures scenarios per second of processor time in SUMO, with one simulation for each or for all of them."""
    import libsumo

    with tempfile.TemporaryDirectory() as folder:
        net, routes = Path(folder, "road.net.xml"), Path(folder, "cars.rou.xml")
        net.write_text(NETWORK)
        routes.write_text(ROUTES)
        options = [
            "-n",
            str(net),
            "-r",
            str(routes),
            "--step-length",
            str(STEP_S),
            "--no-step-log",
            "true",
            "--collision.action",
            "none",
            "--no-warnings",
            "true",
            "--xml-validation",
            "never",
        ]
        libsumo.start(["sumo", *options])
        sumo_scenario(libsumo, 0)
        start_s = time.thread_time()
        for index in range(1, count + 1):
            if load_each:
                libsumo.load(options)
            sumo_scenario(libsumo, index)
        elapsed_s = time.thread_time() - start_s
        libsumo.close()
    return count / elapsed_s


def sumo_scenario(sumo, index):
    """Simulates one scenario in the loaded simulation."""
    names = [f"{index}-{vehicle}" for vehicle in range(3)]
    # Insert far apart, then move together: SUMO refuses to insert vehicles at the paper's spacing.
    for vehicle, name in enumerate(names):
        sumo.vehicle.add(name, "along", "car", departPos=str(1000 - 200 * vehicle), departSpeed=str(SPEED_MPS))
    sumo.simulationStep()
    for vehicle, name in enumerate(names):
        sumo.vehicle.moveTo(name, "road_0", 1000.0 - vehicle * (GAP_M + LENGTH_M))
        sumo.vehicle.setPreviousSpeed(name, SPEED_MPS)
    assert len(sumo.vehicle.getIDList()) == 3, "all three are on the road"
    # Of SUMO's checks on commands, keep only the maximum deceleration.
    sumo.vehicle.setSpeedMode(names[0], 4)
    sumo.vehicle.setDecel(names[0], LEAD_BRAKE_MPS2)
    sumo.vehicle.setSpeed(names[0], SPEED_MPS)
    for _ in range(int(ONSET_S / STEP_S)):
        sumo.simulationStep()
    sumo.vehicle.setSpeed(names[0], 0.0)
    for _ in range(STEPS - 1 - int(ONSET_S / STEP_S)):
        sumo.simulationStep()
    assert sumo.vehicle.getSpeed(names[0]) < 0.1, "the leader stands"
    for name in names:
        sumo.vehicle.remove(name)


def braking_environment():
    """Returns the environment for Stable-Baselines3."""
    import gymnasium
    import numpy as np

    class Braking(gymnasium.Env):
        """Environment of three vehicles. The agent is the middle one; the last one keeps its speed, then brakes."""

        observation_space = gymnasium.spaces.Box(-10.0, 10.0, (8,), np.float32)
        action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)

        def reset(self, *, seed=None, options=None):
            super().reset(seed=seed)
            self.x, self.v, self.a = [36.0, 18.0, 0.0], [SPEED_MPS] * 3, [0.0] * 3
            self.step_count, self.braking = 0, False
            return self.observe(), {}

        def gaps(self):
            return self.x[0] - LENGTH_M - self.x[1], self.x[1] - LENGTH_M - self.x[2]

        def observe(self):
            ahead, behind = self.gaps()
            v, a = self.v, self.a
            numbers = [
                ahead / 16 - 1,
                behind / 16 - 1,
                v[0] / 12.5 - 1,
                v[1] / 12.5 - 1,
                v[2] / 12.5 - 1,
                a[0] / 5,
                a[1] / 5,
                a[2] / 5,
            ]
            return np.array(numbers, dtype=np.float32)

        def step(self, action):
            self.braking |= self.gaps()[1] < 1.4 * (self.v[2] - self.v[1])
            lead = -LEAD_BRAKE_MPS2 if self.step_count * STEP_S >= ONSET_S else 0.0
            self.a = [lead, -2.25 + 5.25 * float(action[0]), -6.0 if self.braking else 0.0]
            for vehicle in range(3):
                speed = max(self.v[vehicle] + self.a[vehicle] * STEP_S, 0.0)
                self.x[vehicle] += 0.5 * (speed + self.v[vehicle]) * STEP_S
                self.v[vehicle] = speed
            self.step_count += 1
            contact = min(self.gaps()) <= 0.0
            return self.observe(), -20.0 if contact else 0.1, contact, self.step_count >= STEPS, {}

    return Braking()


def sb3_decisions_per_s(width, batch, decisions):
    """Measures training decisions per second of processor time in Stable-Baselines3."""
    import numpy as np
    import torch
    from stable_baselines3 import DDPG
    from stable_baselines3.common.noise import NormalActionNoise

    torch.set_num_threads(1)
    model = DDPG(
        "MlpPolicy",
        braking_environment(),
        policy_kwargs={"net_arch": [width] * 3},
        batch_size=batch,
        buffer_size=10_000,
        learning_starts=batch,
        train_freq=(1, "step"),
        gradient_steps=1,
        gamma=0.99999,
        tau=0.005,
        device="cpu",
        seed=1,
        action_noise=NormalActionNoise(np.zeros(1), 0.1 * np.ones(1)),
    )
    # Updates begin when the replay memory contains a batch.
    model.learn(batch + 20)
    start_s = time.thread_time()
    model.learn(decisions, reset_num_timesteps=False)
    return decisions / (time.thread_time() - start_s)


def crumple_figures():
    """Returns crumple's figures by name."""
    command = ["cargo", "bench", "--quiet", "--bench", "targets", "--", "compare"]
    printed = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    return {name: float(value) for name, value in (line.split() for line in printed.splitlines())}


def main():
    """Prints a table of the figures and their ratios."""
    rows = [
        ("scenarios_per_s", "scenarios a second, SUMO, a simulation each", 400, lambda: sumo_scenarios_per_s(50, True)),
        (
            "scenarios_per_s",
            "scenarios a second, SUMO, one after the other in one simulation",
            400,
            lambda: sumo_scenarios_per_s(50, False),
        ),
        (
            "decisions_per_s_64",
            "training decisions a second, Stable-Baselines3, 3 x 64, batch 128",
            10,
            lambda: sb3_decisions_per_s(64, 128, 1000),
        ),
        (
            "decisions_per_s_256",
            "training decisions a second, Stable-Baselines3, 3 x 256, batch 512",
            2.5,
            lambda: sb3_decisions_per_s(256, 512, 300),
        ),
    ]
    ours = crumple_figures()
    print("| figure | other tool | crumple | ratio | target |\n|---|---|---|---|---|")
    for name, title, target, measure in rows:
        try:
            measured = measure()
        except ImportError as error:
            print(f"{title}: not measured, {error}", file=sys.stderr)
            continue
        print(f"| {title} | {measured:.4g} | {ours[name]:.4g} | {ours[name] / measured:.1f} | {target} |")


if __name__ == "__main__":
    main()
