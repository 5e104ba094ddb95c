"""Speed of a count with one and two processes as workers.

`python benches/executor.py [RUNS]`, by default 1 000 000. Prints wall-clock times, so the machine must have two idle
cores: prints the load before, too. Processor times show what the distribution costs, on a busy machine as well. Each
count has new workers, which have simulated a few runs before.
"""

import os
import resource
import sys
import time
from concurrent.futures import ProcessPoolExecutor

import crumple


def processor_time_s():
    """Returns the processor time of this process and of its ended workers."""
    usages = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


def time_count(workers, runs):
    """Returns wall-clock and processor time of a count in seconds, and its certificate."""
    used_s = processor_time_s()
    with ProcessPoolExecutor(workers) as executor:
        list(executor.map(crumple.simulate, ["paper-1"] * (4 * workers)))
        begin = time.perf_counter()
        counted = crumple.rate("baseline", "high-risk", runs=runs, executor=executor, threads=1)
        time_s = time.perf_counter() - begin
    return (time_s, processor_time_s() - used_s), counted.certificate


def main():
    """Measures three times, alternately, and prints the smallest times."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000
    print(f"load of the last minute {os.getloadavg()[0]:.1f} on {len(os.sched_getaffinity(0))} cores")
    times = {1: [], 2: []}
    certificates = []
    for _ in range(3):
        for workers, measured in times.items():
            used, certificate = time_count(workers, runs)
            measured.append(used)
            certificates.append(certificate)
    assert all(certificate == certificates[0] for certificate in certificates)
    (one_s, one_used_s), (two_s, two_used_s) = ([min(column) for column in zip(*times[n], strict=True)] for n in (1, 2))
    print(f"{runs} runs: one worker {one_s:.2f} s, two workers {two_s:.2f} s, {one_s / two_s:.2f} times the work")
    print(f"processor time: one worker {one_used_s:.2f} s, two workers {two_used_s:.2f} s")


if __name__ == "__main__":
    main()
