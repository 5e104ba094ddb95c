"""A controller as a process: keeps 4 m and 1.4 s to the vehicle ahead, and otherwise 30 m/s. The standard library alone.

crumple simulate paper-1 --controller 'exec:python3 follower.py'
"""

import json
import operator
import sys

SEEN = "gap_ahead_m", "relative_speed_ahead_mps", "speed_mps"


def decide(see):
    gap_m, relative_mps, speed_mps = pick(see)
    wanted_mps2 = 0.3 * (gap_m - 4.0 - 1.4 * speed_mps) + 0.9 * relative_mps
    most_mps2 = 2.0 if speed_mps < 28.0 else 30.0 - speed_mps
    wanted_mps2 = most_mps2 if wanted_mps2 > most_mps2 else wanted_mps2
    return wanted_mps2 if wanted_mps2 > -7.5 else -7.5


for line in sys.stdin:
    asked = json.loads(line)
    if "time_s" in asked:  # Formatted by hand: the most frequent query.
        answer = '{"id":%d,"acceleration_mps2":%r}' % (asked["id"], decide(asked["see"]))
    elif "times_s" in asked:  # Several runs at once, because of "batch".
        answer = json.dumps({"id": asked["id"], "acceleration_mps2": [decide(see) for see in asked["see"]]})
    elif "reset" in asked:  # A new run: a controller with memory or noise would reset here.
        answer = '{"id":%d,"ready":true}' % asked["id"]
    else:
        pick = operator.itemgetter(*(asked["hello"]["inputs"].index(name) for name in SEEN))
        batch = "alone" not in sys.argv
        answer = json.dumps({"crumple": 1, "name": "follower.py", "deterministic": True, "batch": batch})
    sys.stdout.write(answer + "\n")
    sys.stdout.flush()
