#!/usr/bin/env python3
"""Runs the shards on HyperQueue: on the workers of a running server, or with --local N on N cores of this machine.

    python3 hyperqueue_job.py [--local N] [--server-dir DIR] [SHARD ...]

Start this program in the folder in which `crumple plan` was started. It keeps finished work: run it until it ends with
exit code 0. All machines need the same files in the same places, and the same build of crumple ($CRUMPLE, or `crumple`
on the PATH). The output of shard N is in `shard-N.out` and `shard-N.err` beside this file, until the shard is complete.
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


def connect(folder):
    """Returns a client of the running server; ends the program if there is none."""
    try:
        return Client(folder)
    except Exception as error:  # The package has no more specific exception.
        where = f"with files in {folder} " if folder else ""
        reason = (str(error).splitlines() or ["no reason is given"])[0]
        hint = "`hq server start` starts one, --local N starts one for this job"
        sys.exit(f"no server of HyperQueue {where}runs here ({hint}): {reason}")


def log(shard, ending):
    """Returns the path of a shard's output."""
    return TASK.parent / f"shard-{shard}.{ending}"


def main():
    parser = argparse.ArgumentParser(description="Runs the shards on HyperQueue.")
    parser.add_argument("--local", type=int, metavar="N", help="run on N cores of this machine")
    parser.add_argument("--server-dir", metavar="DIR", help="folder of the server's files [default: that of hq]")
    parser.add_argument("shards", nargs="*", type=int, metavar="SHARD", help="shards to run [default: all]")
    arguments = parser.parse_args()
    with ExitStack() as stack:
        if arguments.local:
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="crumple-hyperqueue-"))
            cluster = stack.enter_context(LocalCluster(folder, WorkerConfig(cores=arguments.local)))
            client = cluster.client()
        else:
            client = connect(arguments.server_dir)
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
        is_complete = client.wait_for_jobs([submitted], raise_on_error=False)
        failed = set() if is_complete else {tasks[task] for task in client.get_failed_tasks(submitted)}
        for shard in set(tasks.values()) - failed:
            log(shard, "out").unlink(missing_ok=True)
            log(shard, "err").unlink(missing_ok=True)
        if not is_complete:
            sys.exit(f"incomplete shards: {sorted(failed)}, see {log('N', 'err')}; run this program again")


if __name__ == "__main__":
    main()
