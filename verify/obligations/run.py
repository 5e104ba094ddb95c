#!/usr/bin/env python3
"""Runs z3 and cvc5, where installed, on every obligation and records what they said in results.json.

Neither is needed to build, run or test anything here: `pip install z3-solver cvc5` gives both. A result is recorded with
the solver's version and the SHA-256 of the file it speaks about; those of other files and solvers are kept.
"""

import hashlib
import json
import pathlib
import resource
import subprocess
import sys

HERE = pathlib.Path(__file__).resolve().parent
SECONDS = 60  # of processor time, so that a busy machine answers the same

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
    done = subprocess.run([sys.executable, "-c", VERSIONS[solver]], capture_output=True, text=True)
    return done.stdout.strip() if done.returncode == 0 else None


def answer(solver, path):
    command = [sys.executable, "-c", PROGRAMS[solver], str(path)]
    limit = lambda: resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
    done = subprocess.run(command, capture_output=True, text=True, preexec_fn=limit)
    if done.returncode < 0:
        return f"no answer in {SECONDS} s"
    said = done.stdout.strip()
    return said if said in ("sat", "unsat", "unknown") else "failed"


def main():
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
            said = answer(solver, path)
            wrong += {said, expected} == {"sat", "unsat"}
            print(f"{solver} {found}: {name}: {said}{'' if said == expected else f', not {expected}'}", flush=True)
            results = [r for r in results if (r["file"], r["solver"]) != (name, solver)]
            results.append(
                {"file": name, "sha256": digests[name], "solver": solver, "version": found, "result": said}
            )
    results.sort(key=lambda r: (r["file"], r["solver"]))
    record.write_text(json.dumps(results, indent=2) + "\n")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
