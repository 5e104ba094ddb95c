"""Controller as a process: keeps 4 m and 1.4 s to the leader, and otherwise 30 m/s. Needs the standard library only.

crumple simulate paper-1 --controller 'exec:python3 follower.py'
"""

import json
import operator
import sys

INPUTS = "gap_ahead_m", "relative_speed_ahead_mps", "speed_mps"


def decide(see):
    """Returns the commanded acceleration for the inputs of one vehicle."""
    gap_m, relative_mps, speed_mps = pick(see)
    command_mps2 = 0.3 * (gap_m - 4.0 - 1.4 * speed_mps) + 0.9 * relative_mps
    max_mps2 = 2.0 if speed_mps < 28.0 else 30.0 - speed_mps
    command_mps2 = max_mps2 if command_mps2 > max_mps2 else command_mps2
    return command_mps2 if command_mps2 > -7.5 else -7.5


for line in sys.stdin:
    query = json.loads(line)
    if "time_s" in query:  # Formatted by hand: the most frequent query.
        answer = '{"id":%d,"acceleration_mps2":%r}' % (query["id"], decide(query["see"]))
    elif "times_s" in query:  # Several runs at once, because the answer to "hello" has "batch".
        answer = json.dumps({"id": query["id"], "acceleration_mps2": [decide(see) for see in query["see"]]})
    elif "reset" in query:  # A new run: a controller with memory or noise would reset here.
        answer = '{"id":%d,"ready":true}' % query["id"]
    else:
        pick = operator.itemgetter(*(query["hello"]["inputs"].index(name) for name in INPUTS))
        batch = "alone" not in sys.argv
        answer = json.dumps({"crumple": 1, "name": "follower.py", "deterministic": True, "batch": batch})
    sys.stdout.write(answer + "\n")
    sys.stdout.flush()
