#!/usr/bin/env python3
"""Runs the Python examples of docs/scale.md with few runs, and compares the certificates with that of one process.

Kills a worker of Dask and one of Ray during a task: the result is the same.
"""

import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import crumple

PAGE = Path(__file__).resolve().parent.parent / "docs/scale.md"
PYTHON_BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
RUNS = 5000
TIMEOUT_S = 900


def run_examples():
    """Runs each example as a program, and compares the bytes of its certificate."""
    with tempfile.TemporaryDirectory() as folder:
        crumple.rate("road", "high-risk", runs=RUNS, folder=Path(folder) / "count")
        expected = (Path(folder) / "count/certificate.json").read_bytes()
    examples = PYTHON_BLOCK.findall(PAGE.read_text())
    assert len(examples) == 3, len(examples)
    for example in examples:
        assert example.count("1_000_000") == 1
        with tempfile.TemporaryDirectory() as folder:
            program = Path(folder) / "example.py"
            program.write_text(example.replace("1_000_000", f'{RUNS}, folder="count"'))
            done = subprocess.run(
                [sys.executable, program], capture_output=True, text=True, timeout=TIMEOUT_S, cwd=folder
            )
            assert done.returncode == 0, done.stderr
            assert (Path(folder) / "count/certificate.json").read_bytes() == expected, done.stdout
        print(f"{re.findall('import .*', example)}: the certificate has the same bytes")


def slow(observation):
    """Keeps a worker busy for long enough to be killed."""
    time.sleep(2e-5)
    return -1.0 if observation.gap_ahead_m is not None and observation.gap_ahead_m < 25 else 0.0


def run_marked(folder, function, *arguments):
    """Runs a task. A file with the number of the process exists in ``folder`` during the task."""
    mark = folder / str(os.getpid())
    mark.touch()
    try:
        return function(*arguments)
    finally:
        mark.unlink()


class MarkingExecutor:
    """Executor that marks the processes of running tasks in a folder."""

    def __init__(self, executor, folder):
        self.executor = executor
        self.folder = folder

    def submit(self, function, *arguments):
        """Starts a marked call."""
        return self.executor.submit(run_marked, self.folder, function, *arguments)


def count(**options):
    """Counts with a controller of this module."""
    controller = crumple.Controller(slow, interval_s=0.5, name="slow", identity="slow, version 1")
    return crumple.rate(controller, "high-risk", runs=6000, confidence=0.9, threads=1, **options)


def count_while_a_worker_dies(executor, expected):
    """Counts, kills a worker during a task, and compares the result."""
    killed = []

    def kill_once(*_):
        running = [int(mark.name) for mark in marks.iterdir()]
        if running and not killed:
            killed.append(running[0])
            os.kill(running[0], signal.SIGKILL)

    with tempfile.TemporaryDirectory() as folder:
        marks = Path(folder)
        result = count(executor=MarkingExecutor(executor, marks), progress=kill_once)
        # A task that was over would have removed its mark.
        assert [mark.name for mark in marks.iterdir()] == [str(pid) for pid in killed]
    assert len(killed) == 1
    assert (result.tally, result.certificate) == (expected.tally, expected.certificate)


def main():
    """Runs all checks."""
    run_examples()
    expected = count()
    import ray
    from dask.distributed import Client

    from crumple.ray import RayExecutor

    with Client(n_workers=2, threads_per_worker=1, dashboard_address=None) as client:
        count_while_a_worker_dies(client.get_executor(), expected)
    print("Dask: a killed worker changes nothing")
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    count_while_a_worker_dies(RayExecutor(), expected)
    ray.shutdown()
    print("Ray: a killed worker changes nothing")


if __name__ == "__main__":
    main()
