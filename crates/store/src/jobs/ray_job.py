#!/usr/bin/env python3
"""Has the shards made by Ray: on the cluster that --address or RAY_ADDRESS names, or with --local N on N cores of this machine.

    python3 ray_job.py --local N [SHARD ...]
    python3 ray_job.py --address ADDRESS [SHARD ...]

ADDRESS is `auto` for the cluster that this machine is of. No cluster is begun but with --local, and that one asks for no token and writes
none. Start it in the folder in which `crumple plan` was started. Finished work is kept: run it until it ends with exit code 0. All machines need the
same files in the same places, and the same build of crumple ($CRUMPLE, or `crumple` on the PATH).
"""

import argparse
import ctypes
import os
import signal
import subprocess
import sys
from pathlib import Path

SHARDS = @SHARDS@
CORES = @CORES@
TASK = Path(__file__).resolve().parent / "task.sh"


def end_with_parent():
    """A worker that is killed takes its shard with it: else the next worker would find the folder in use."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)


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


def connected(local, address):
    """Ray, connected to what was named and to nothing else."""
    if not local and not address:
        sys.exit("no cluster is named: --address auto is the one that this machine is of, --local N begins one on N cores of it")
    if local or address == "local":
        # Nothing but this machine reaches it: no token is needed, and none is written. Ray reads this when it is imported.
        os.environ["RAY_AUTH_MODE"] = "disabled"
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    import ray

    try:
        if local:
            ray.init(address="local", num_cpus=local, include_dashboard=False)
        else:
            ray.init(address=address)
    except (ConnectionError, RuntimeError, ValueError) as error:
        sys.exit(f"no cluster answers at {address}: {str(error).splitlines()[0]}")
    return ray


def main():
    parser = argparse.ArgumentParser(description="Has the shards made by Ray.")
    parser.add_argument("--local", type=int, metavar="N", help="on N cores of this machine")
    parser.add_argument("--address", default=os.environ.get("RAY_ADDRESS"), help="of a cluster that runs [default: RAY_ADDRESS]")
    parser.add_argument("shards", nargs="*", type=int, metavar="SHARD", help="these alone")
    arguments = parser.parse_args()
    ray = connected(arguments.local, arguments.address)
    remote = ray.remote(num_cpus=CORES, max_retries=3)(make)
    crumple = os.environ.get("CRUMPLE", "crumple")
    shards = arguments.shards or range(1, SHARDS + 1)
    waiting = {remote.remote(shard, os.getcwd(), crumple): shard for shard in shards}
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
