"""A controller: the Intelligent Driver Model. Replace `decide`. As a program it is a process of crumple."""

import crumple


def decide(seen):
    """Returns the commanded acceleration, in m/s², for a `crumple.Observation`."""
    free_road_mps2 = 1.5 * (1.0 - (seen.speed_mps / 33.0) ** 4)
    if seen.gap_ahead_m is None:
        return free_road_mps2
    closing_mps = seen.speed_mps - seen.speed_ahead_mps
    desired_gap_m = 2.0 + max(1.2 * seen.speed_mps + seen.speed_mps * closing_mps / 3.0, 0.0)
    command_mps2 = free_road_mps2 - 1.5 * (desired_gap_m / max(seen.gap_ahead_m, 0.1)) ** 2
    return max(-9.0, min(1.5, command_mps2))


if __name__ == "__main__":
    crumple.serve(decide)
