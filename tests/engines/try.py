#!/usr/bin/env python3
"""Tries the job files of `crumple plan` on this machine: shards on an engine, two workers killed at random moments, the job begun again
until it is done, merged, and compared with a count by one process, byte by byte.

    python3 tests/engines/try.py hyperqueue|ray [--rounds 10] [--runs 40000] [--crumple target/release/crumple]
    python3 tests/engines/try.py hyperqueue --efficiency

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
FILES = ["registration.json", "progress.json", "certificate.json", "work.json"]
CONTROLLER = ["--controller=idm", "--space=high-risk", "--seed=7", "--confidence=0.99"]


def begun(words, environment):
    # A session of its own: whatever is left of it can be ended with it.
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


def one_round(number, engine, crumple, runs, single, seconds, root):
    folder = root / f"round-{number}"
    folder.mkdir()
    os.chdir(folder)
    plan = ["plan", *CONTROLLER, f"--runs={runs}", f"--shards={SHARDS}", f"--engine={engine}", "--out=campaign"]
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
        merged = subprocess.run([crumple, "--quiet", "merge", *folders, "--out=rate"], capture_output=True)
        if (folders and merged.returncode != 1) or again == 10:
            break
        again += 1
        subprocess.run([sys.executable, job, "--local", "2"], env=environment, capture_output=True)
    same = merged.returncode == 0 and all(filecmp.cmp(f"rate/{name}", single / name, shallow=False) for name in FILES)
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


def efficiency(crumple, runs, root):
    """The same count by two threads, and by eight shards on a HyperQueue of two cores, in turns."""
    os.chdir(root)
    plan = ["plan", *CONTROLLER, f"--runs={runs}", f"--shards={SHARDS}", "--engine=hyperqueue", "--out=campaign"]
    subprocess.run([crumple, "--quiet", *plan], check=True, stdout=subprocess.DEVNULL)
    for number in range(3):
        begin = time.monotonic()
        rate = [crumple, "--quiet", "verify", "rate", *CONTROLLER, f"--runs={runs}", f"--out=threads-{number}"]
        subprocess.run(rate, check=True, stdout=subprocess.DEVNULL, env={**os.environ, "RAYON_NUM_THREADS": "2"})
        threads = time.monotonic() - begin
        shutil.rmtree("campaign/shards", ignore_errors=True)
        begin = time.monotonic()
        job = [sys.executable, "campaign/hyperqueue_job.py", "--local", "2"]
        subprocess.run(job, check=True, capture_output=True, env={**os.environ, "CRUMPLE": crumple})
        shards = time.monotonic() - begin
        print(f"two threads {threads:.1f} s, 8 shards on HyperQueue {shards:.1f} s: {100 * threads / shards:.0f} %", flush=True)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("engine", choices=["hyperqueue", "ray"])
    parser.add_argument("--rounds", type=int, default=10)
    parser.add_argument("--runs", type=int, default=40_000)
    parser.add_argument("--crumple", default="target/release/crumple")
    parser.add_argument("--seed", type=int, default=0, help="of the moments and the victims")
    parser.add_argument("--efficiency", action="store_true")
    arguments = parser.parse_args()
    random.seed(arguments.seed)
    crumple = str(Path(arguments.crumple).resolve())
    with tempfile.TemporaryDirectory(prefix="crumple-engines-") as name:
        root = Path(name)
        if arguments.efficiency:
            efficiency(crumple, arguments.runs, root)
            return
        single, begin = root / "single", time.monotonic()
        rate = [crumple, "--quiet", "verify", "rate", *CONTROLLER, f"--runs={arguments.runs}", f"--out={single}"]
        subprocess.run(rate, check=True, stdout=subprocess.DEVNULL)
        seconds = time.monotonic() - begin
        print(f"{arguments.engine}: {SHARDS} shards of {arguments.runs} runs, {seconds:.1f} s by one process", flush=True)
        rounds = range(1, arguments.rounds + 1)
        same = [one_round(n, arguments.engine, crumple, arguments.runs, single, seconds, root) for n in rounds]
        print(f"{sum(same)} of {len(same)} rounds with two workers killed came to the bytes of the single run")
        sys.exit(0 if all(same) else 1)


if __name__ == "__main__":
    main()
