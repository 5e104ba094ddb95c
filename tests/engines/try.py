#!/usr/bin/env python3
"""Tests the job files of `crumple plan` on this machine, with workers that are killed.

    python3 tests/engines/try.py hyperqueue|ray [--rounds 10] [--runs 40000]
                                 [--crumple target/release/crumple]
    python3 tests/engines/try.py hyperqueue --efficiency

Runs shards on an engine, kills two workers at random times, restarts the job until it is complete, and merges the
shards. The result must equal, byte by byte, that of one process.

Needs `pip install hyperqueue` or `pip install ray`. The package of HyperQueue has server and workers in one process, so
a worker to be killed is a process with a cluster of one core and two of the eight shards. Ray's workers are processes.
"""

import argparse
import filecmp
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

SHARDS = 8
# Target duration of a task for the measurement of efficiency, and the minimum efficiency.
TASK_SECONDS = 10
MIN_PERCENT = 90


class Rate:
    """Count of failures in `runs` runs."""

    common = ["--controller=idm", "--space=high-risk", "--seed=7", "--confidence=0.99"]
    merged = "rate"

    def planned(self, runs):
        return [*self.common, f"--runs={runs}"]

    def whole(self, runs):
        return ["verify", "rate", *self.common, f"--runs={runs}"]

    def expected(self, crumple, runs, root):
        subprocess.run(
            [crumple, "--quiet", *self.whole(runs), f"--out={root / 'single'}"], check=True, stdout=subprocess.DEVNULL
        )


def same_files(one, other):
    """Returns true if two folders have the same files, byte by byte; `work.lock` is always empty."""
    names = [{str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()} for folder in (one, other)]
    return names[0] == names[1] and all(filecmp.cmp(one / name, other / name, shallow=False) for name in names[0])


def start(words, environment):
    """Starts a process in a new session, so that all of its processes can be ended."""
    return subprocess.Popen(
        words, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )


def busy_ray_workers(process):
    """Returns the process ids of the session's Ray workers that run a shard."""
    found = []
    for place in Path("/proc").glob("[0-9]*"):
        try:
            of_session = os.getsid(int(place.name)) == process.pid
            if of_session and (place / "cmdline").read_bytes().startswith(b"ray::run_shard"):
                found.append(int(place.name))
        except (OSError, ProcessLookupError):
            continue
    return found


def kill(pid):
    """Kills a process; returns the number of killed processes."""
    try:
        os.kill(pid, signal.SIGKILL)
        return 1
    except ProcessLookupError:
        return 0


def kill_hyperqueue_workers(job, environment, seconds):
    """Runs four workers with two shards each, and kills two of them; returns the number of killed ones."""
    shares = [[str(shard) for shard in range(1 + node, SHARDS + 1, 4)] for node in range(4)]
    workers = [start([sys.executable, job, "--local", "1", *shards], environment) for shards in shares]
    killed, start_s = 0, time.monotonic()
    for moment in sorted(random.uniform(0.3, 0.35 * seconds) for _ in range(2)):
        time.sleep(max(0.0, start_s + moment - time.monotonic()))
        alive = [worker for worker in workers if worker.poll() is None]
        victim = random.choice(alive) if alive else None
        if victim is not None and kill(victim.pid):
            victim.wait()
            killed += 1
    for worker in workers:
        worker.wait()
    return killed


def kill_ray_workers(job, environment, seconds):
    """Runs a cluster, and kills two workers that run a shard; returns the number of killed ones."""
    cluster = start([sys.executable, job, "--local", "2"], environment)
    killed = 0
    while killed < 2 and cluster.poll() is None:
        time.sleep(random.uniform(0.2, seconds / 4))
        workers = busy_ray_workers(cluster)
        killed += kill(random.choice(workers)) if workers else 0
    cluster.wait()
    return killed


def run_round(number, engine, work, crumple, runs, single, seconds, root):
    """Runs the shards with killed workers; returns true if the result equals that in `single`."""
    folder = root / f"round-{number}"
    folder.mkdir()
    os.chdir(folder)
    plan = ["plan", *work.planned(runs), f"--shards={SHARDS}", f"--engine={engine}", "--out=campaign"]
    subprocess.run([crumple, "--quiet", *plan], check=True, stdout=subprocess.DEVNULL)
    environment = {**os.environ, "CRUMPLE": crumple}
    job = f"campaign/{engine}_job.py"
    killed = {"hyperqueue": kill_hyperqueue_workers, "ray": kill_ray_workers}[engine](job, environment, seconds)
    shards = Path("campaign/shards")
    missing = sum(not is_finished(shards / str(shard)) for shard in range(1, SHARDS + 1))
    restarts = 0
    while True:
        folders = [str(folder) for folder in shards.glob("*")]
        random.shuffle(folders)
        merged = subprocess.run([crumple, "--quiet", "merge", *folders, f"--out={work.merged}"], capture_output=True)
        if (folders and merged.returncode != 1) or restarts == 10:
            break
        restarts += 1
        subprocess.run([sys.executable, job, "--local", "2"], env=environment, capture_output=True)
    same = merged.returncode == 0 and same_files(Path(work.merged), single)
    print(
        f"round {number}: {killed} workers killed, {missing} shards unfinished, {restarts} restarts: "
        f"{'identical result' if same else 'DIFFERENT RESULT'}",
        flush=True,
    )
    os.chdir(root)
    shutil.rmtree(folder)
    return same and killed == 2


def is_finished(folder):
    """Returns true if a shard is complete."""
    try:
        return '"program": null' in (folder / "work.json").read_text()
    except OSError:
        return False


def efficiency(work, crumple, root):
    """Compares two threads of one process with eight shards on HyperQueue with two cores, in alternation.

    Each shard takes about ten seconds. Returns true if the efficiency reaches its minimum.
    """
    os.chdir(root)
    threads_environment = {**os.environ, "RAYON_NUM_THREADS": "2"}
    load = os.getloadavg()[0]
    runs = 20_000
    for _ in range(3):
        begin = time.monotonic()
        words = [crumple, "--quiet", *work.whole(runs), f"--out=measured-{runs}"]
        subprocess.run(words, check=True, stdout=subprocess.DEVNULL, env=threads_environment)
        seconds = time.monotonic() - begin
        # Eight tasks on two cores take four rounds.
        target = SHARDS / 2 * TASK_SECONDS
        if 0.8 < seconds / target < 1.25:
            break
        runs = int(runs * target / seconds)
    shard_s = seconds * 2 / SHARDS
    name = type(work).__name__.lower()
    print(f"load before {load:.1f}; {name} with {runs} runs, {SHARDS} shards of about {shard_s:.0f} s", flush=True)
    plan = ["plan", *work.planned(runs), f"--shards={SHARDS}", "--engine=hyperqueue", "--out=campaign"]
    subprocess.run([crumple, "--quiet", *plan], check=True, stdout=subprocess.DEVNULL)
    shares = []
    for number in range(3):
        begin = time.monotonic()
        words = [crumple, "--quiet", *work.whole(runs), f"--out=threads-{number}"]
        subprocess.run(words, check=True, stdout=subprocess.DEVNULL, env=threads_environment)
        threads = time.monotonic() - begin
        shutil.rmtree("campaign/shards", ignore_errors=True)
        begin = time.monotonic()
        job = [sys.executable, "campaign/hyperqueue_job.py", "--local", "2"]
        subprocess.run(job, check=True, capture_output=True, env={**os.environ, "CRUMPLE": crumple})
        shards = time.monotonic() - begin
        shares.append(100 * threads / shards)
        print(
            f"two threads {threads:.1f} s, {SHARDS} shards on HyperQueue {shards:.1f} s: {shares[-1]:.0f} %", flush=True
        )
    median = sorted(shares)[1]
    verdict = "reached" if median >= MIN_PERCENT else "NOT reached"
    print(f"median {median:.0f} %: {MIN_PERCENT} % {verdict}; start and end of the engine are counted")
    return median >= MIN_PERCENT


def main():
    """Runs the rounds, or measures the efficiency."""
    parser = argparse.ArgumentParser()
    parser.add_argument("engine", choices=["hyperqueue", "ray"])
    parser.add_argument("--rounds", type=int, default=10)
    parser.add_argument("--runs", type=int, default=40_000, help="runs of the count")
    parser.add_argument("--crumple", default="target/release/crumple")
    parser.add_argument("--seed", type=int, default=0, help="seed of the times and of the killed workers")
    parser.add_argument(
        "--efficiency",
        action="store_true",
        help="measure the efficiency, with tasks of ten seconds; needs an idle machine",
    )
    arguments = parser.parse_args()
    random.seed(arguments.seed)
    crumple = str(Path(arguments.crumple).resolve())
    work = Rate()
    with tempfile.TemporaryDirectory(prefix="crumple-engines-") as name:
        root = Path(name)
        if arguments.efficiency:
            sys.exit(0 if efficiency(work, crumple, root) else 1)
        single, begin = root / "single", time.monotonic()
        work.expected(crumple, arguments.runs, root)
        seconds = time.monotonic() - begin
        task = f"{SHARDS} shards of {arguments.runs} runs"
        print(f"{arguments.engine}: {task}, {seconds:.1f} s by one process", flush=True)
        rounds = range(1, arguments.rounds + 1)
        same = [run_round(n, arguments.engine, work, crumple, arguments.runs, single, seconds, root) for n in rounds]
        print(f"{sum(same)} of {len(same)} rounds with two killed workers have the identical result")
        sys.exit(0 if all(same) else 1)


if __name__ == "__main__":
    main()
