"""Converts the JUnit file of a report and of a suite, and checks the links to requirements: `junit.py PROGRAM`.

`.ci/junit` runs this program in an environment with ub-test-reports.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

from ub_test_reports.junitparser import JUnitParser
from ub_test_reports.needs_export import build_needs_file

CONFIG = """\
version = 1
controllers = ["idm", "acc-aeb", "acc-aeb,ttc_s=1.5", "acc-aeb,ttc_s=2.5"]
subject = "acc-aeb"
draws = 20
everyday_draws = 0
search = { budget = 5 }
rates = { runs = 20 }
suites = [{ suite = "one.toml" }, { suite = "two.toml" }]

[[gates]]
require = "no-collision-in-paper-scenarios"
controller = "acc-aeb"
requirement = ["REQ-1", "REQ-2"]

[[gates]]
require = "proofs-accepted"
requirement = ["REQ-2"]
"""
# Fields of links, by the properties of test cases.
LINKS = {"FullyVerifies": "fully_verifies", "PartiallyVerifies": "partially_verifies"}


def links_of(path):
    """Returns the name of each test case with the requirements that it verifies fully and partially."""
    suites = JUnitParser(str(path)).parse()
    exported = build_needs_file([(path.name, suites)], link_properties=LINKS)
    (version,) = exported["versions"].values()
    return {
        need["title"]: (need["fully_verifies"], need["partially_verifies"], need["result"])
        for need in version["needs"].values()
    }


def main(program):
    """Writes a report and a suite, and checks their links."""
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        (folder / "a.toml").write_text(CONFIG)
        # The converter refuses cases that it takes for one: equal tests of two suites and of two settings.
        lanes = (Path(__file__).parent.parent / "examples/suites/lane-changes.toml").read_text()
        for name in ("one", "two"):
            (folder / f"{name}.toml").write_text(lanes.replace('"lane-changes"', f'"{name}"', 1))
        subprocess.run([program, "assess", "a.toml", "--out", "report", "--quiet"], cwd=folder, check=True)
        cases = links_of(folder / "report/assessment.junit.xml")
        linked = {name: case for name, case in cases.items() if case[0] or case[1]}
        wanted = {
            "acc-aeb: no collision in the paper's scenarios": (["REQ-1"], ["REQ-2"], "passed"),
            "the checker accepts every certificate": ([], ["REQ-2"], "passed"),
        }
        assert linked == wanted, linked
        suite = subprocess.run([program, "show", "un-r152"], check=True, capture_output=True, text=True).stdout
        own = suite.replace('name = "un-r152"', 'name = "own"', 1)
        marker = "[[clauses.tests]]\n"
        assert marker in own, "a suite has tests"
        (folder / "own.toml").write_text(own.replace(marker, marker + 'requirement = ["REQ-3"]\n', 1))
        command = [program, "suite", "run", "own.toml", "--controller", "idm", "--format", "junit", "--quiet"]
        junit = folder / "suite.xml"
        junit.write_bytes(subprocess.run(command, cwd=folder, check=False, capture_output=True).stdout)
        suites = [case for case in links_of(junit).values() if case[0]]
        assert [case[0] for case in suites] == [["REQ-3"]], suites
        print(f"ub-test-reports links {len(cases)} cases of a report, and a suite, to their requirements")


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve())
