#!/usr/bin/env python3
"""What checking costs, two checkers in turns: python3 benches/check.py OLD NEW [COMMIT]

OLD and NEW are programs `crumple-verify`; COMMIT (028db87, the last with certificates of version 1) has the certificates, which both can
read. Two are made larger besides: an escape and a proof of 1500 steps, written with version 2 by `crumple avoid --certificate FILE` and
given as FILE...; they are written again with version 1, and the cases of a proof are cut so that none spans more than five firings.
Prints the seconds of a processor for one certificate, the least of seven.
"""

import json
import pathlib
import resource
import subprocess
import sys
import tempfile

NAMES = ["heavy-behind-heavy", "rate-policy", "policy-against-baseline", "reach-paper-1", "reach-paper-2"]


def seconds(program, policy, file, times):
    def spent():
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        return used.ru_utime + used.ru_stime

    before = spent()
    done = subprocess.run([program, "--policy", policy, *[file] * times], stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode:
        sys.exit(f"{program}: {done.stdout}")
    return (spent() - before) / times


def as_version_1(text):
    certificate = json.loads(text)
    certificate["version"] = 1
    kept = ("crumple", "scenario", "scenario_sha256")
    certificate["provenance"] = {key: certificate["provenance"][key] for key in kept}
    (statement,) = certificate["statement"].values()
    if "branches" in statement:
        cut = [(branch, first) for branch in statement["branches"] for first in range(branch["first"], branch["last"] + 1, 5)]
        statement["branches"] = [{**branch, "first": first, "last": min(branch["last"], first + 4)} for branch, first in cut]
    return json.dumps(certificate)


def main():
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
        for given in map(pathlib.Path, sys.argv[4:]):
            files[given.stem] = folder / given.name
            files[given.stem].write_text(as_version_1(given.read_text()))
        for name, file in files.items():
            times = 5 if name.startswith("reach") else 50
            turns = [[seconds(program, folder / "policy", file, times) for program in programs] for _ in range(7)]
            old, new = map(min, zip(*turns))
            print(f"{name}: {1e3 * old:.3g} ms, {1e3 * new:.3g} ms: {new / old:.2f} times", flush=True)


if __name__ == "__main__":
    main()
