#!/usr/bin/env python3
"""Compares the times of two certificate checkers: `python3 benches/check.py OLD NEW [COMMIT [FILE...]]`.

OLD and NEW are programs `crumple-verify`. The certificates are those of COMMIT (by default 028db87, the last commit
with certificates of version 1, which both programs read). FILE... are further certificates of version 2, as written by
`crumple avoid --certificate FILE`; they are converted to version 1, and the branches of a proof are cut so that none
spans more than five firings. Prints the processor times for one certificate, each the shortest of seven.
"""

import json
import pathlib
import resource
import subprocess
import sys
import tempfile

NAMES = ["heavy-behind-heavy", "rate-policy", "policy-against-baseline", "reach-paper-1", "reach-paper-2"]


def check_time_s(program, policy, file, times):
    """Returns the processor time for one check, as a mean of `times` checks."""

    def processor_time_s():
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        return used.ru_utime + used.ru_stime

    before_s = processor_time_s()
    done = subprocess.run(
        [program, "--policy", policy, *[file] * times], stdout=subprocess.PIPE, text=True, check=False
    )
    if done.returncode:
        sys.exit(f"{program}: {done.stdout}")
    return (processor_time_s() - before_s) / times


def as_version_1(text):
    """Converts a certificate of version 2 to version 1."""
    certificate = json.loads(text)
    certificate["version"] = 1
    fields = ("crumple", "scenario", "scenario_sha256")
    certificate["provenance"] = {key: certificate["provenance"][key] for key in fields}
    (statement,) = certificate["statement"].values()
    if "branches" in statement:
        cut = [
            (branch, first)
            for branch in statement["branches"]
            for first in range(branch["first"], branch["last"] + 1, 5)
        ]
        statement["branches"] = [
            {**branch, "first": first, "last": min(branch["last"], first + 4)} for branch, first in cut
        ]
    return json.dumps(certificate)


def main():
    """Prints a line for each certificate."""
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    programs, commit = sys.argv[1:3], (sys.argv[3:4] or ["028db87"])[0]

    def committed(path):
        return subprocess.run(["git", "show", f"{commit}:{path}"], stdout=subprocess.PIPE, check=True).stdout

    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        (folder / "policy").write_bytes(committed("corpora/policy/reference.safetensors"))
        files = {}
        for name in NAMES:
            files[name] = folder / name
            files[name].write_bytes(committed(f"reports/certificates/{name}.json"))
        for extra in map(pathlib.Path, sys.argv[4:]):
            files[extra.stem] = folder / extra.name
            files[extra.stem].write_text(as_version_1(extra.read_text()))
        for name, file in files.items():
            times = 5 if name.startswith("reach") else 50
            turns = [[check_time_s(program, folder / "policy", file, times) for program in programs] for _ in range(7)]
            old, new = map(min, zip(*turns))
            print(f"{name}: {1e3 * old:.3g} ms, {1e3 * new:.3g} ms: {new / old:.2f} times", flush=True)


if __name__ == "__main__":
    main()
