#!/usr/bin/env python3
"""Prints random car-following events of ten seconds in crumple's format: `braking_events.py COUNT [SEED]`.

In each event the leader brakes once.
"""

import random
import sys

random.seed(int(sys.argv[2]) if len(sys.argv) > 2 else 0)
print("event,time_s,gap_m,follower_speed_mps,relative_speed_mps,leader_speed_mps")
for event in range(int(sys.argv[1])):
    speed = min(max(random.gauss(20.0, 5.0), 9.0), 40.0)
    brake = 1.5 + random.gammavariate(2.0, 0.7)
    time_gap = random.lognormvariate(0.2, 0.4)
    follower = speed * random.gauss(1.0, 0.03)
    def leader_at(now):
        return max(speed - brake * min(max(now - 3.0, 0.0), 2.0), 0.0)

    # The follower has its own speed until the leader brakes, and then that of the leader 0.3 s before.
    gap = time_gap * follower + 2.0 * (follower - speed)
    before = None
    for tenth in range(100):
        now = tenth / 10.0
        leader, own = leader_at(now), follower if now < 3.0 else leader_at(now - 0.3)
        if before is not None:
            gap += 0.05 * (before + leader - own)
        before = leader - own
        print(f"{event},{now:.1f},{gap:.3f},{own:.3f},{leader - own:.3f},{leader:.3f}")
