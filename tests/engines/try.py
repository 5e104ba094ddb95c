#!/usr/bin/env python3
"""Tries the job files of `crumple plan` on this machine: shards on an engine, two workers killed at random moments, the job begun again
until it is done, merged, and compared byte by byte: a count with that by one process, a search with the merging of eight shards that nobody
disturbed.

    python3 tests/engines/try.py hyperqueue|ray [--work rate|falsify] [--rounds 10] [--runs 40000] [--crumple target/release/crumple]
    python3 tests/engines/try.py hyperqueue --efficiency [--work rate|falsify]

Needs `pip install hyperqueue` or `pip install ray`. The package of HyperQueue holds server and workers in one process; so a worker to be
killed is a process with a cluster of one core and two of the eight shards. Ray's workers are processes of their own.
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
LEAST_PERCENT = 90


class Rate:
    """A count: `runs` of it."""

    common = ["--controller=idm", "--space=high-risk", "--seed=7", "--confidence=0.99"]
    merged = "rate"
    # Share of one process's time in which the engine's workers are certain to work.
    at_work = 1.0

    def planned(self, runs):
        return [*self.common, f"--runs={runs}"]

    def whole(self, runs):
        return ["verify", "rate", *self.common, f"--runs={runs}"]

    def expected(self, crumple, runs, root):
        subprocess.run([crumple, "--quiet", *self.whole(runs), f"--out={root / 'single'}"], check=True, stdout=subprocess.DEVNULL)


class Falsify(Rate):
    """A search: a budget of `runs` evaluations for each of three methods."""

    common = ["--controller=match-leader", "--space=high-risk", "--seed=7"]
    merged = "campaign-merged"
    # Eight sequential processes take longer.
    at_work = 0.3

    def planned(self, runs):
        return [*self.common, f"--budget={runs}"]

    def whole(self, runs):
        return ["falsify", *self.common, f"--budget={runs}", "--log=summary"]

    def expected(self, crumple, runs, root):
        # A divided search is eight searches: compare it with eight undisturbed shards.
        shards = [str(root / f"undisturbed-{shard}") for shard in range(1, SHARDS + 1)]
        for shard, folder in enumerate(shards, 1):
            words = ["falsify", *self.common, f"--budget={runs}", f"--shard={shard}/{SHARDS}", f"--out={folder}"]
            subprocess.run([crumple, "--quiet", *words], check=True, stdout=subprocess.DEVNULL)
        subprocess.run([crumple, "--quiet", "merge", *shards, f"--out={root / 'single'}"], check=True, stdout=subprocess.DEVNULL)


def same_files(one, other):
    """Whether two folders hold the same files, byte by byte; `work.lock` is empty everywhere."""
    names = [{str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()} for folder in (one, other)]
    return names[0] == names[1] and all(filecmp.cmp(one / name, other / name, shallow=False) for name in names[0])


def begun(words, environment):
    # A separate session, so that all of its processes can be ended.
    return subprocess.Popen(
        words, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )


def below(process):
    """Workers of Ray that are at work on a shard, among all processes of a session."""
    found = []
    for place in Path("/proc").glob("[0-9]*"):
        try:
            of_session = os.getsid(int(place.name)) == process.pid
            if of_session and (place / "cmdline").read_bytes().startswith(b"ray::make"):
                found.append(int(place.name))
        except (OSError, ProcessLookupError):
            continue
    return found


def kill(pid):
    try:
        os.kill(pid, signal.SIGKILL)
        return 1
    except ProcessLookupError:
        return 0


def killed_hyperqueue(job, environment, seconds):
    """Four workers with two shards each, two of which are killed."""
    share = [[str(shard) for shard in range(1 + node, SHARDS + 1, 4)] for node in range(4)]
    workers = [begun([sys.executable, job, "--local", "1", *shards], environment) for shards in share]
    killed, start = 0, time.monotonic()
    for moment in sorted(random.uniform(0.3, 0.35 * seconds) for _ in range(2)):
        time.sleep(max(0.0, start + moment - time.monotonic()))
        alive = [worker for worker in workers if worker.poll() is None]
        victim = random.choice(alive) if alive else None
        if victim is not None and kill(victim.pid):
            victim.wait()
            killed += 1
    for worker in workers:
        worker.wait()
    return killed


def killed_ray(job, environment, seconds):
    """One cluster, two of whose workers are killed while they make a shard."""
    cluster = begun([sys.executable, job, "--local", "2"], environment)
    killed = 0
    while killed < 2 and cluster.poll() is None:
        time.sleep(random.uniform(0.2, seconds / 4))
        workers = below(cluster)
        killed += kill(random.choice(workers)) if workers else 0
    cluster.wait()
    return killed


def one_round(number, engine, work, crumple, runs, single, seconds, root):
    folder = root / f"round-{number}"
    folder.mkdir()
    os.chdir(folder)
    plan = ["plan", *work.planned(runs), f"--shards={SHARDS}", f"--engine={engine}", "--out=campaign"]
    subprocess.run([crumple, "--quiet", *plan], check=True, stdout=subprocess.DEVNULL)
    environment = {**os.environ, "CRUMPLE": crumple}
    job = f"campaign/{engine}_job.py"
    killed = {"hyperqueue": killed_hyperqueue, "ray": killed_ray}[engine](job, environment, seconds)
    shards = Path("campaign/shards")
    missing = sum(not finished(shards / str(shard)) for shard in range(1, SHARDS + 1))
    again = 0
    while True:
        folders = [str(folder) for folder in shards.glob("*")]
        random.shuffle(folders)
        merged = subprocess.run([crumple, "--quiet", "merge", *folders, f"--out={work.merged}"], capture_output=True)
        if (folders and merged.returncode != 1) or again == 10:
            break
        again += 1
        subprocess.run([sys.executable, job, "--local", "2"], env=environment, capture_output=True)
    same = merged.returncode == 0 and same_files(Path(work.merged), single)
    print(f"round {number}: {killed} workers killed, {missing} shards unfinished, begun again {again} times: "
          f"{'the same bytes' if same else 'NOT THE SAME'}", flush=True)
    os.chdir(root)
    shutil.rmtree(folder)
    return same and killed == 2


def finished(folder):
    try:
        return '"program": null' in (folder / "work.json").read_text()
    except OSError:
        return False


def efficiency(work, crumple, root):
    """The same work by two threads of one process, and by eight shards on a HyperQueue of two cores, in turns; each shard takes about ten
    seconds of a core. Of a search other points are evaluated, but as many."""
    os.chdir(root)
    threads_environment = {**os.environ, "RAYON_NUM_THREADS": "2"}
    busy = os.getloadavg()[0]
    runs = 20_000
    for _ in range(3):
        begin = time.monotonic()
        words = [crumple, "--quiet", *work.whole(runs), f"--out=measured-{runs}"]
        subprocess.run(words, check=True, stdout=subprocess.DEVNULL, env=threads_environment)
        seconds = time.monotonic() - begin
        # Eight tasks on two cores take four rounds.
        wanted = SHARDS / 2 * TASK_SECONDS
        if 0.8 < seconds / wanted < 1.25:
            break
        runs = int(runs * wanted / seconds)
    print(f"load before it began {busy:.1f}; {runs} of {type(work).__name__.lower()}, {SHARDS} shards of about {seconds * 2 / SHARDS:.0f} s", flush=True)
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
        print(f"two threads {threads:.1f} s, {SHARDS} shards on HyperQueue {shards:.1f} s: {shares[-1]:.0f} %", flush=True)
    median = sorted(shares)[1]
    verdict = "reached" if median >= LEAST_PERCENT else "NOT reached"
    print(f"median {median:.0f} %: {LEAST_PERCENT} % {verdict}; the engine's start and end are counted")
    return median >= LEAST_PERCENT


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("engine", choices=["hyperqueue", "ray"])
    parser.add_argument("--rounds", type=int, default=10)
    parser.add_argument("--work", choices=["rate", "falsify"], default="rate")
    parser.add_argument("--runs", type=int, default=40_000, help="runs of a count, evaluations of a search")
    parser.add_argument("--crumple", default="target/release/crumple")
    parser.add_argument("--seed", type=int, default=0, help="of the moments and the victims")
    parser.add_argument("--efficiency", action="store_true", help="measure it, with tasks of ten seconds; needs an idle machine")
    arguments = parser.parse_args()
    random.seed(arguments.seed)
    crumple = str(Path(arguments.crumple).resolve())
    work = {"rate": Rate, "falsify": Falsify}[arguments.work]()
    with tempfile.TemporaryDirectory(prefix="crumple-engines-") as name:
        root = Path(name)
        if arguments.efficiency:
            sys.exit(0 if efficiency(work, crumple, root) else 1)
        single, begin = root / "single", time.monotonic()
        work.expected(crumple, arguments.runs, root)
        seconds = (time.monotonic() - begin) * work.at_work
        print(f"{arguments.engine}: {SHARDS} shards of {arguments.work}, {arguments.runs} runs, {seconds / work.at_work:.1f} s by one process", flush=True)
        rounds = range(1, arguments.rounds + 1)
        same = [one_round(n, arguments.engine, work, crumple, arguments.runs, single, seconds, root) for n in rounds]
        print(f"{sum(same)} of {len(same)} rounds with two workers killed came to the same bytes")
        sys.exit(0 if all(same) else 1)


if __name__ == "__main__":
    main()
