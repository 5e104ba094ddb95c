"""Recomputes the figures of the study of rear-end collisions from its raw runs. Needs only Python 3.9.

    aeb_behind REPORT                  compares REPORT/runs.csv with REPORT/assessment.json, and prints the tables
    aeb_behind REPORT PAGE [--write]   compares the table, pictures and figures of the text of PAGE, or writes the table
                                       and the pictures
    aeb_behind sensitivity CRUMPLE FOLDER [PAGE]
                                       runs the study in FOLDER with one assumption changed at a time, prints the table,
                                       and compares the medians of PAGE
    aeb_behind mildest CRUMPLE [PAGE]  prints the mildest brakes that pass the modelled lead-vehicle tests
"""

import json
import math
import re
import subprocess
import sys
from pathlib import Path

from drives import REFERENCE, clopper_pearson, read_groups
from figures import check_page, statements, tables
from picture import draw
from sensitivity import sensitivity


def compare(groups, report):
    """Compares the counts with those of the assessment. Returns the number of compared figures."""
    compared = 0

    def equal(what, own, stated, tolerance=0.0):
        nonlocal compared
        compared += 1
        if abs(own - stated) > tolerance:
            sys.exit(f"error: {what}: {own} from the runs, and the report states {stated}")

    for stated in report["harm"]["groups"]:
        key = stated["follower"]
        reference = groups[key][REFERENCE]
        for own, theirs in zip(reference.avoidable, stated["avoidable"]):
            equal(f"{key} avoidable", own, theirs)
        for one in stated["controllers"]:
            own, what = groups[key][one["controller"]], f"{key} {one['controller']}"
            activations = sum(own.active)
            mean = sum(own.harm) / own.count
            error = 1.96 * math.sqrt(sum((value - mean) ** 2 for value in own.harm)) / own.count
            equal(what + " activations", activations, one["activations"])
            equal(what + " avoided", own.only("ahead", reference)[1], one["avoided"])
            equal(what + " caused", own.only("behind", reference)[0], one["caused"])
            equal(what + " harm", 1000 * mean, one["harm_per_1000"][0], 0.0006)
            equal(what + " error of harm", 1000 * error, one["harm_per_1000"][1], 0.0006)
            for field, count, of in [
                ("ahead_percent", sum(own.ahead), own.count),
                ("behind_percent", sum(own.behind), own.count),
                ("caused_per_100_activations", own.during_activations("behind", reference)[0], activations),
            ]:
                low, high = clopper_pearson(count, of)
                equal(f"{what} {field}", 100 * count / max(of, 1), one[field]["observed"], 0.006)
                equal(f"{what} {field}, lower", 100 * low, one[field]["lower"], 0.011)
                equal(f"{what} {field}, upper", 100 * high, one[field]["upper"], 0.011)
    return compared


def suite_verdicts(report):
    """Returns whether each controller passes the lead-vehicle tests (clause S7.1) of the suite."""
    verdicts = {}
    for suite in report.get("suites", {}).get("suites", []):
        for test in suite["tests"]:
            if test["clause"] == "S7.1":
                for name, outcome in zip(suite["controllers"], test["outcomes"]):
                    passes = outcome["passed"] and verdicts.get(name, "yes") == "yes"
                    verdicts[name] = "yes" if passes else "no"
    return verdicts


def show(folder, page, is_written):
    report = json.loads((folder / "assessment.json").read_text())
    groups = read_groups(folder / "runs.csv")
    print(f"{compare(groups, report)} figures of the assessment agree with the runs.", flush=True)
    passing = suite_verdicts(report)
    made = tables(groups, passing, report["harm"]["emergencies_per_hour"])
    if page is None:
        print("\n\n".join(made.values()))
        return
    for group, follower in (("all", "all four types"), ("human", "human driver"),
                            ("baseline", "coasts until its emergency brake fires")):
        path = page.with_suffix("") / f"{group}.svg"
        drawn = draw(f"Vehicle behind: {follower}", groups[group], passing)
        if is_written:
            path.write_text(drawn)
        elif path.read_text() != drawn:
            sys.exit(f"error: {path} is not the picture of the runs")
    check_page(page, {"all": made["all"]}, statements(groups), is_written)


def mildest(crumple, page):
    found = []
    for threshold in (1.4, 1.6, 1.8, 2, 2.2, 2.4, 2.6, 2.8, 3, 3.5, 4):
        for braking in (4.75 + 0.25 * step for step in range(12)):
            name = f"emergency-brake,ttc_s={threshold:g},brake_mps2={braking:g}"
            command = [crumple, "suite", "run", "fmvss-127", "--controller", name]
            lines = subprocess.run(command, capture_output=True, text=True).stdout.split("\nS9 ")[0]
            if len(re.findall(r" emergency-brake\S*: PASSED, ", lines)) == 3:
                found.append(f"{braking:g} {'from' if found else 'm/s² from'} {threshold:g} s")
                break
    if page:
        check_page(page, {}, [", ".join(found)], False)
    else:
        print(", ".join(found))


if __name__ == "__main__":
    is_written = "--write" in sys.argv
    arguments = [one for one in sys.argv[1:] if one != "--write"]
    page = lambda place: Path(arguments[place]) if len(arguments) > place else None
    if arguments[:1] == ["sensitivity"] and len(arguments) in (3, 4):
        sensitivity(Path(arguments[1]).resolve(), Path(arguments[2]), page(3))
    elif arguments[:1] == ["mildest"] and len(arguments) in (2, 3):
        mildest(Path(arguments[1]).resolve(), page(2))
    elif len(arguments) in (1, 2) and (Path(arguments[0]) / "runs.csv").is_file():
        show(Path(arguments[0]), page(1), is_written)
    else:
        sys.exit(__doc__)
