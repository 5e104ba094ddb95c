#!/usr/bin/env python3
"""Measures search methods for controllers outside the program: simulations to the first failure, and busy threads.

    cargo build --release -p crumple -p crumple-fmu && python3 benches/slow_systems.py target/release/crumple

Needs Linux and a C compiler. Busy threads are measured with a process that waits in each simulation: the
seconds waited, divided by the seconds that passed, with eight threads.
"""

import json
import os
import pathlib
import subprocess
import sys
import tempfile
import time
import zipfile

EXAMPLES = pathlib.Path(__file__).resolve().parent.parent / "examples" / "controllers"
METHODS = "auto", "cma-es", "cross-entropy", "uniform", "halton"
PROBLEMS = (
    ("FMU", "fmu.toml", "assisted"),
    ("FMU", "fmu.toml", "standing"),
    ("process in C", "c.toml", "slower"),
    ("process in C", "c.toml", "traffic"),
    ("process in Python", "python.toml", "high-risk"),
)
BUDGET = 200
SEEDS, FIRST_SEED = 30, 70000
# crumple waits at most one second for an answer.
THREADS, WAITING_RUNS, WAIT_S = 8, 96, 0.5


def build(folder):
    """Compiles the process and the FMU, and writes their controller files."""
    library = folder / "follower.so"
    subprocess.run(["cc", "-O2", "-o", folder / "follower", EXAMPLES / "follower.c", "-lm"], check=True)
    source = EXAMPLES / "fmu" / "follower.c"
    subprocess.run(["cc", "-O2", "-shared", "-fPIC", "-o", library, source, "-lm"], check=True)
    with zipfile.ZipFile(folder / "follower.fmu", "w") as archive:
        archive.write(EXAMPLES / "fmu" / "modelDescription.xml", "modelDescription.xml")
        archive.write(library, "binaries/linux64/follower.so")
    text = (EXAMPLES / "follower.py").read_text()
    wait = f'elif "reset" in query:\n        open("waits", "a").write("1")\n        time.sleep({WAIT_S})'
    (folder / "follower.py").write_text(text)
    text = text.replace('elif "reset" in query:', wait).replace("import sys", "import sys\nimport time")
    (folder / "waiting.py").write_text(text)
    text = (EXAMPLES / "follower.toml").read_text()
    (folder / "python.toml").write_text(text)
    in_c = text.replace('"python3", "follower.py"', '"./follower"').replace("follower.py", "follower")
    (folder / "c.toml").write_text(in_c)
    (folder / "fmu.toml").write_text('version = 1\nfmu = "follower.fmu"\ndecision_interval_s = 0.1\n')
    text = text.replace('"follower.py"]', '"follower.py", "alone"]', 1).replace("follower.py", "waiting.py")
    (folder / "waiting.toml").write_text(text.replace("_s = 0.1", "_s = 1.0"))


def compare(crumple, folder, controller, space, methods, *options):
    """Returns the comparison of methods as crumple prints it."""
    command = [crumple, "falsify", "--controller", controller, "--space", space, "--compare", ",".join(methods)]
    done = subprocess.run([*command, *options, "--format", "json", "--quiet"], cwd=folder, check=True, stdout=-1)
    return json.loads(done.stdout)


def busy_threads(crumple, folder, method):
    """Returns the mean number of busy threads; no simulation fails."""
    os.environ["RAYON_NUM_THREADS"] = str(THREADS)
    waits = folder / "waits"
    waits.unlink(missing_ok=True)
    start = time.monotonic()
    options = "--spec", "always v1.gap_m > -1000", "--seeds", "1", "--budget", str(WAITING_RUNS)
    compare(crumple, folder, "waiting.toml", "paper", [method], *options)
    del os.environ["RAYON_NUM_THREADS"]
    return WAIT_S * waits.stat().st_size / (time.monotonic() - start)


def is_better_than_auto(pair):
    """Returns true if the other method needs significantly fewer simulations, or fails significantly less often."""
    tests = pair["falsified"], pair["fewer_simulations"]
    return pair["methods"][0] == "auto" and any(
        test["p_corrected"] < 0.05 and test["second"] > test["first"] for test in tests)


def main():
    """Prints a table, and the counts and p-values of the tests to standard error."""
    crumple = os.path.abspath(sys.argv[1])
    print(f"{SEEDS} seeds from {FIRST_SEED}, at most {BUDGET} simulations\n")
    print("| problem | " + " | ".join(METHODS) + " | significantly better than `auto` |")
    print("|---" * (len(METHODS) + 2) + "|")
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        build(folder)
        cells = [f"{busy_threads(crumple, folder, method):.1f}" for method in METHODS]
        print(f"| busy threads of {THREADS} | {' | '.join(cells)} | |", flush=True)
        for problem, controller, space in PROBLEMS:
            options = "--seeds", str(SEEDS), "--seed", str(FIRST_SEED), "--budget", str(BUDGET)
            found = compare(crumple, folder, controller, space, METHODS, *options)
            cells = []
            for runs in found["methods"]:
                mean = runs["mean_simulations"]
                text = "-" if mean is None else f"{mean:.1f}"
                cells.append(text if runs["falsified"] == SEEDS else f"{text} ({runs['falsified']})")
            better = ", ".join(pair["methods"][1] for pair in found["pairs"] if is_better_than_auto(pair))
            print(*(f"{pair['methods'][1]}: {test}" for pair in found["pairs"] if pair["methods"][0] == "auto"
                    for test in (pair["falsified"], pair["fewer_simulations"])), sep="\n", file=sys.stderr)
            print(f"| {problem}, `{space}` | {' | '.join(cells)} | {better or 'none'} |", flush=True)


if __name__ == "__main__":
    main()
