#!/usr/bin/env python3
"""Runs the shards on Ray: on the cluster at --address or RAY_ADDRESS, or with --local N on N cores of this machine.

    python3 ray_job.py --local N [SHARD ...]
    python3 ray_job.py --address ADDRESS [SHARD ...]

ADDRESS is `auto` for the cluster of this machine. Only --local starts a cluster, without a token. Start this program in
the folder in which `crumple plan` was started. It keeps finished work: run it until it ends with exit code 0. All
machines need the same files in the same places, and the same build of crumple ($CRUMPLE, or `crumple` on the PATH).
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
    """Ends this process when its worker is killed; otherwise the next worker would find the folder in use."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)


def run_shard(shard, folder, crumple):
    """Runs one shard; returns its exit code and its error output."""
    environment = {**os.environ, "CRUMPLE": crumple}
    process = subprocess.run(
        ["sh", str(TASK), str(shard)],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        errors="replace",
        preexec_fn=end_with_parent,
    )
    return process.returncode, process.stderr


def connect(local, address):
    """Connects Ray to the named cluster only; ends the program if there is none."""
    if not local and not address:
        sys.exit("no cluster is named: use --address auto for that of this machine, or --local N to start one")
    if local or address == "local":
        # Only this machine reaches a local cluster, so it needs no token. Ray reads these variables during its import.
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
    parser = argparse.ArgumentParser(description="Runs the shards on Ray.")
    parser.add_argument("--local", type=int, metavar="N", help="run on N cores of this machine")
    address = os.environ.get("RAY_ADDRESS")
    parser.add_argument("--address", default=address, help="address of a running cluster [default: RAY_ADDRESS]")
    parser.add_argument("shards", nargs="*", type=int, metavar="SHARD", help="shards to run [default: all]")
    arguments = parser.parse_args()
    ray = connect(arguments.local, arguments.address)
    remote = ray.remote(num_cpus=CORES, max_retries=3)(run_shard)
    crumple = os.environ.get("CRUMPLE", "crumple")
    shards = arguments.shards or range(1, SHARDS + 1)
    waiting = {remote.remote(shard, os.getcwd(), crumple): shard for shard in shards}
    failed = []
    while waiting:
        for done in ray.wait(list(waiting), num_returns=1)[0]:
            shard = waiting.pop(done)
            try:
                code, message = ray.get(done)
            except ray.exceptions.RayError as error:
                code, message = 1, str(error).splitlines()[0]
            if code != 0:
                failed.append(shard)
                print(f"shard {shard}: {message.strip()}", file=sys.stderr)
    ray.shutdown()
    if failed:
        sys.exit(f"incomplete shards: {sorted(failed)}; run this program again")


if __name__ == "__main__":
    main()
