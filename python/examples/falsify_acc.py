"""Searches for scenarios in which a simple adaptive cruise control fails, and shows the worst.

    python falsify_acc.py [BUDGET]

Needs only NumPy. The controller keeps a time gap and a set speed, and ignores how hard the leader can brake.
"""

import sys

import numpy as np

import crumple

TIME_GAP_S, STANDSTILL_M, SET_SPEED_MPS = 1.0, 3.0, 33.0


def cruise(rows):
    """Returns accelerations for rows of ``crumple.OBSERVATION``."""
    gap_m, ahead_mps, own_mps = rows[:, 0], rows[:, 2], rows[:, 3]
    free = 0.4 * (SET_SPEED_MPS - own_mps)
    follow = 0.25 * (gap_m - STANDSTILL_M - TIME_GAP_S * own_mps) + 0.9 * (ahead_mps - own_mps)
    # Without a leader its values are NaN, and the set speed decides.
    return np.clip(np.fmin(free, follow), -5.0, 2.0)


def main(budget):
    """Searches, replays and draws failures; returns them."""
    acc = crumple.Controller(
        cruise, batch=True, interval_s=0.1, name="acc", identity=f"acc {TIME_GAP_S} {STANDSTILL_M}"
    )
    found = crumple.falsify(acc, "high-risk", budget=budget)
    print(found)
    for failure in found.failures[:3]:
        collision = failure.replay().collision
        print(f"{failure.kind}: {collision['impact_speed_mps']:.1f} m/s at {collision['time_s']:.1f} s")
    if found.failures:
        found.failures[0].plot().save("acc-fails.svg")
        print("wrote acc-fails.svg")
    mildest = crumple.worst_case("paper-1", acc, budget=budget)
    print(
        f"a leader that brakes at {mildest.peak_brake_mps2:.2f} m/s² suffices"
        if mildest.found
        else "no braking suffices"
    )
    return found.failures


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 1000)
