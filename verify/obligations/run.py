#!/usr/bin/env python3
"""Runs z3 and cvc5, if installed, on every obligation and records their results in results.json.

No build, run or test needs the solvers; `pip install z3-solver cvc5` installs both. A result has the solver's version
and the SHA-256 of the file. Results of other files and solvers stay.
"""

import hashlib
import json
import pathlib
import resource
import subprocess
import sys

HERE = pathlib.Path(__file__).resolve().parent
# Limit of processor time, so that results do not depend on the load of the machine.
LIMIT_S = 60

Z3 = """
import sys, z3
solver = z3.SolverFor("QF_NRA")
solver.from_file(sys.argv[1])
print(solver.check())
"""
CVC5 = """
import sys, cvc5
solver = cvc5.Solver()
parser = cvc5.InputParser(solver)
parser.setFileInput(cvc5.InputLanguage.SMT_LIB_2_6, sys.argv[1])
while not (command := parser.nextCommand()).isNull():
    print(command.invoke(solver, parser.getSymbolManager()), end="")
"""
VERSIONS = {"z3": "import z3; print(z3.get_version_string())", "cvc5": "import cvc5; print(cvc5.__version__)"}
PROGRAMS = {"z3": Z3, "cvc5": CVC5}


def version(solver):
    """Returns the version of a solver; None if it is not installed."""
    done = subprocess.run([sys.executable, "-c", VERSIONS[solver]], capture_output=True, text=True)
    return done.stdout.strip() if done.returncode == 0 else None


def answer(solver, path):
    """Returns the result of a solver for a file."""
    command = [sys.executable, "-c", PROGRAMS[solver], str(path)]
    limit = lambda: resource.setrlimit(resource.RLIMIT_CPU, (LIMIT_S, LIMIT_S))
    done = subprocess.run(command, capture_output=True, text=True, preexec_fn=limit)
    if done.returncode < 0:
        return f"no answer in {LIMIT_S} s"
    result = done.stdout.strip()
    return result if result in ("sat", "unsat", "unknown") else "failed"


def main():
    """Runs all solvers on all files; returns 1 if a result contradicts the expected one."""
    record = HERE / "results.json"
    old = json.loads(record.read_text()) if record.exists() else []
    files = sorted(path for path in HERE.glob("*/*.smt2") if path.parent.name != "statements")
    digests = {path.relative_to(HERE).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}
    results = [result for result in old if digests.get(result["file"]) == result["sha256"]]
    wrong = 0
    for solver in PROGRAMS:
        found = version(solver)
        if found is None:
            print(f"{solver}: not installed, skipped")
            continue
        for path in files:
            name = path.relative_to(HERE).as_posix()
            expected = "unsat" if "(set-info :status unsat)" in path.read_text() else "sat"
            actual = answer(solver, path)
            wrong += {actual, expected} == {"sat", "unsat"}
            print(f"{solver} {found}: {name}: {actual}{'' if actual == expected else f', not {expected}'}", flush=True)
            results = [r for r in results if (r["file"], r["solver"]) != (name, solver)]
            results.append(
                {"file": name, "sha256": digests[name], "solver": solver, "version": found, "result": actual}
            )
    results.sort(key=lambda r: (r["file"], r["solver"]))
    record.write_text(json.dumps(results, indent=2) + "\n")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
