#!/usr/bin/env python3
"""Has the shards made by Ray: on the cluster that RAY_ADDRESS names, or with --local N on N cores of this machine.

    python3 ray_job.py [--local N] [SHARD ...]

Begin it where `crumple plan` was begun. What is done is not done again: run it until it ends with exit code 0. All machines need the
same files in the same places, and the same build of crumple ($CRUMPLE, or `crumple` on the PATH).
"""

import argparse
import ctypes
import os
import signal
import subprocess
import sys
from pathlib import Path

import ray

SHARDS = @SHARDS@
CORES = @CORES@
TASK = Path(__file__).resolve().parent / "task.sh"


def end_with_parent():
    """A worker that is killed takes its shard with it: else the next worker would find the folder in use."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)


@ray.remote(num_cpus=CORES, max_retries=3)
def make(shard, folder, crumple):
    environment = {**os.environ, "CRUMPLE": crumple}
    made = subprocess.run(
        ["sh", str(TASK), str(shard)],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        errors="replace",
        preexec_fn=end_with_parent,
    )
    return made.returncode, made.stderr


def main():
    parser = argparse.ArgumentParser(description="Has the shards made by Ray.")
    parser.add_argument("--local", type=int, metavar="N", help="on N cores of this machine")
    parser.add_argument("shards", nargs="*", type=int, metavar="SHARD", help="these alone")
    arguments = parser.parse_args()
    if arguments.local:
        # Nothing but this machine reaches it: no token is needed, and none is written.
        os.environ["RAY_AUTH_MODE"] = "disabled"
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        ray.init(address="local", num_cpus=arguments.local, include_dashboard=False)
    else:
        ray.init()
    crumple = os.environ.get("CRUMPLE", "crumple")
    shards = arguments.shards or range(1, SHARDS + 1)
    waiting = {make.remote(shard, os.getcwd(), crumple): shard for shard in shards}
    failed = []
    while waiting:
        for done in ray.wait(list(waiting), num_returns=1)[0]:
            shard = waiting.pop(done)
            try:
                code, said = ray.get(done)
            except ray.exceptions.RayError as error:
                code, said = 1, str(error).splitlines()[0]
            if code != 0:
                failed.append(shard)
                print(f"shard {shard}: {said.strip()}", file=sys.stderr)
    ray.shutdown()
    if failed:
        sys.exit(f"not made: {sorted(failed)}; run this again")


if __name__ == "__main__":
    main()
