#!/usr/bin/env python3
"""Measures search methods for controllers outside the program: simulations to the first failure, and busy cores.

    cargo build --release -p crumple -p crumple-fmu && python3 benches/slow_systems.py target/release/crumple [SEEDS] [FIRST_SEED]

Needs Linux and a C compiler. Busy cores are the processor time of crumple and the programs it starts, divided by the
time that passed.
"""

import json
import os
import pathlib
import resource
import subprocess
import sys
import tempfile
import time
import zipfile

EXAMPLES = pathlib.Path(__file__).resolve().parent.parent / "examples" / "controllers"
METHODS = "auto", "cma-es", "cross-entropy", "uniform", "halton"
PROBLEMS = (
    ("FMU", "follower.fmu", "high-risk"),
    ("FMU, queue", "follower.fmu", "standing"),
    ("process in C", "exec:./follower", "slower"),
    ("process in C, traffic", "exec:./follower", "traffic"),
    ("process in Python", f"exec:{sys.executable} {EXAMPLES / 'follower.py'}", "assisted"),
)
BUDGET = 300


def build(folder):
    """Compiles the process and the FMU."""
    library = folder / "follower.so"
    subprocess.run(["cc", "-O2", "-o", folder / "follower", EXAMPLES / "follower.c", "-lm"], check=True)
    source = EXAMPLES / "fmu" / "follower.c"
    subprocess.run(["cc", "-O2", "-shared", "-fPIC", "-o", library, source, "-lm"], check=True)
    with zipfile.ZipFile(folder / "follower.fmu", "w") as archive:
        archive.write(EXAMPLES / "fmu" / "modelDescription.xml", "modelDescription.xml")
        archive.write(library, "binaries/linux64/follower.so")


def processor_s():
    """Returns the processor time of all ended children."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def measure(crumple, folder, controller, space, seeds, first):
    """Returns the comparison, and for each method the busy cores."""
    options = ["--space", space, "--seeds", str(seeds), "--seed", str(first), "--budget", str(BUDGET)]
    command = [crumple, "falsify", "--controller", controller, *options, "--format", "json", "--quiet", "--compare"]
    busy = []
    for method in METHODS:
        start, before = time.monotonic(), processor_s()
        subprocess.run([*command, method], cwd=folder, check=True, stdout=subprocess.DEVNULL)
        busy.append((processor_s() - before) / (time.monotonic() - start))
    done = subprocess.run([*command, ",".join(METHODS)], cwd=folder, check=True, capture_output=True)
    return json.loads(done.stdout), busy


def main():
    """Prints a table."""
    crumple = os.path.abspath(sys.argv[1])
    seeds, first = [int(value) for value in sys.argv[2:]] + [100, 70000][len(sys.argv) - 2:]
    print(f"{seeds} seeds from {first}, at most {BUDGET} simulations, {os.cpu_count()} cores\n")
    print("| problem, space | " + " | ".join(METHODS) + " | busy cores |")
    print("|---" * (len(METHODS) + 2) + "|")
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        build(folder)
        for problem, controller, space in PROBLEMS:
            found, busy = measure(crumple, folder, controller, space, seeds, first)
            cells = []
            for runs in found["methods"]:
                mean = runs["mean_simulations"]
                text = "-" if mean is None else f"{mean:.1f}"
                cells.append(text if runs["falsified"] == seeds else f"{text} ({runs['falsified']})")
            print(f"| {problem}, `{space}` | {' | '.join(cells)} | {min(busy):.1f} to {max(busy):.1f} |", flush=True)
            worse = [
                pair for pair in found["pairs"]
                if "auto" in pair["methods"]
                and any(test["p_corrected"] < 0.05 and test["second"] > test["first"]
                        for test in (pair["falsified"], pair["fewer_simulations"]))
            ]
            for pair in worse:
                print(f"  auto is worse: {pair}")


if __name__ == "__main__":
    main()
