#!/usr/bin/env python3
"""Writes reference data of the multi-body plant: `.ci/multi_body.py OUT.csv [SEED]`. `.ci/nightly plant` tests with it.

Needs the PyPI package `commonroad-vehicle-models` 3.0.2 with `numpy`. Simulates 100 random sequences of demands on a
straight road by the classical method of Runge and Kutta with a step of 1 ms. Each line has the vehicle (1 to 3), the
initial speed, 5 demands of 0.4 s each, and after each of them position, speed, pitch angle, and the angular speeds of
the front and the rear wheels.

The package's tyre has a lateral force without slip angle (`r_vy1`), equal on both sides, which pushes a braking car
sideways. The data is without it. The program prints how much it changes the results.
"""

import random
import sys

from vehiclemodels.init_mb import init_mb
from vehiclemodels.vehicle_dynamics_mb import vehicle_dynamics_mb
from vehiclemodels.vehicle_parameters import setup_vehicle_parameters

STEP_S = 1e-3
STEPS = 400
STATES = (0, 3, 8, 23, 25)
# The wheels need a smaller step at lower speeds.
MIN_SPEED_MPS = 5.0


def step(state, demand_mps2, parameters):
    """Returns the state after one step. The package sets wheels to rest in the state that it receives."""

    def rates(state):
        return vehicle_dynamics_mb(state, [0.0, demand_mps2], parameters)

    def moved(step_s, derivative):
        return [value + step_s * rate for value, rate in zip(state, derivative)]

    first = rates(state)
    second = rates(moved(0.5 * STEP_S, first))
    third = rates(moved(0.5 * STEP_S, second))
    fourth = rates(moved(STEP_S, third))
    stages = zip(first, second, third, fourth)
    return moved(STEP_S / 6.0, [a + 2.0 * b + 2.0 * c + d for a, b, c, d in stages])


def simulate(vehicle, speed_mps, demands_mps2, symmetrical):
    """Returns the recorded states after each demand."""
    parameters = setup_vehicle_parameters(vehicle)
    if symmetrical:
        parameters.tire.r_vy1 = 0.0
    state = init_mb([0.0, 0.0, 0.0, speed_mps, 0.0, 0.0, 0.0], parameters)
    recorded = []
    for demand_mps2 in demands_mps2:
        for _ in range(STEPS):
            state = step(state, demand_mps2, parameters)
        recorded.append([state[index] for index in STATES])
    return recorded


def main():
    """Writes the data."""
    chance = random.Random(int(sys.argv[2]) if len(sys.argv) > 2 else 55)
    lines, asymmetry = [], 0.0
    while len(lines) < 100:
        vehicle = 1 + len(lines) % 3
        speed_mps = round(chance.uniform(20.0, 35.0), 1)
        demands_mps2 = [round(chance.uniform(-11.0, 1.0), 1) for _ in range(5)]
        recorded = simulate(vehicle, speed_mps, demands_mps2, True)
        if recorded[-1][1] < MIN_SPEED_MPS:
            continue
        if len(lines) % 10 == 0:
            other = simulate(vehicle, speed_mps, demands_mps2, False)
            asymmetry = max(asymmetry, abs(other[-1][0] / recorded[-1][0] - 1.0))
        values = [vehicle, speed_mps, *demands_mps2, *(value for record in recorded for value in record)]
        lines.append(",".join(map(repr, values)))
    with open(sys.argv[1], "w", encoding="utf-8") as file:
        file.write("\n".join(lines) + "\n")
    print(f"largest relative change of the distance by the lateral force: {asymmetry:.1e}")


main()
