#!/usr/bin/env python3
"""Has the shards made by HyperQueue: by the workers of the server that runs, or with --local N on N cores of this machine.

    python3 hyperqueue_job.py [--local N] [--server-dir DIR] [SHARD ...]

Start it in the folder in which `crumple plan` was started. Finished work is kept: run it until it ends with exit code 0. All machines need the
same files in the same places, and the same build of crumple ($CRUMPLE, or `crumple` on the PATH). What is said while shard N is made
lies beside this file, in `shard-N.out` and `shard-N.err`; once the shard is made both are removed.
"""

import argparse
import os
import sys
import tempfile
from contextlib import ExitStack
from pathlib import Path

from hyperqueue import Job
from hyperqueue.client import Client
from hyperqueue.cluster import LocalCluster, WorkerConfig
from hyperqueue.ffi.protocol import ResourceRequest

SHARDS = @SHARDS@
CORES = @CORES@
TASK = Path(__file__).resolve().parent / "task.sh"


def connected(folder):
    """The server that runs."""
    try:
        return Client(folder)
    except Exception as error:  # The package has no other name for it.
        where = f"that keeps its files in {folder} " if folder else ""
        said = str(error).splitlines() or ["no reason is given"]
        sys.exit(f"no server of HyperQueue {where}runs here (`hq server start` starts one, --local N begins one for this job): {said[0]}")


def log(shard, ending):
    """Where it goes what is said while a shard is made."""
    return TASK.parent / f"shard-{shard}.{ending}"


def main():
    parser = argparse.ArgumentParser(description="Has the shards made by HyperQueue.")
    parser.add_argument("--local", type=int, metavar="N", help="on N cores of this machine")
    parser.add_argument("--server-dir", metavar="DIR", help="where the server keeps its files, if not in its usual place")
    parser.add_argument("shards", nargs="*", type=int, metavar="SHARD", help="these alone")
    arguments = parser.parse_args()
    with ExitStack() as stack:
        if arguments.local:
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="crumple-hyperqueue-"))
            cluster = stack.enter_context(LocalCluster(folder, WorkerConfig(cores=arguments.local)))
            client = cluster.client()
        else:
            client = connected(arguments.server_dir)
        crumple = os.environ.get("CRUMPLE", "crumple")
        job = Job(default_workdir=os.getcwd(), max_fails=None, default_env={"CRUMPLE": crumple}, name="crumple")
        tasks = {}
        for shard in arguments.shards or range(1, SHARDS + 1):
            task = job.program(
                ["sh", str(TASK), str(shard)],
                stdout=str(log(shard, "out")),
                stderr=str(log(shard, "err")),
                resources=ResourceRequest(cpus=CORES),
            )
            tasks[task.task_id] = shard
        submitted = client.submit(job)
        is_made = client.wait_for_jobs([submitted], raise_on_error=False)
        failed = set() if is_made else {tasks[task] for task in client.get_failed_tasks(submitted)}
        for shard in set(tasks.values()) - failed:
            log(shard, "out").unlink(missing_ok=True)
            log(shard, "err").unlink(missing_ok=True)
        if not is_made:
            sys.exit(f"not made: {sorted(failed)}, see {log('N', 'err')}; run this again")


if __name__ == "__main__":
    main()
