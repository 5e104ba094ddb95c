"""Compares ten figures of a run of crumple with those of a second simulator, `emergencies.py`.

The figures were chosen in questions.toml before the simulator ran. Those of crumple are compared with
reports/aeb-behind/results.csv, too.
"""

import csv
import math
import sys
import tempfile
import tomllib
from pathlib import Path
from statistics import NormalDist

from emergencies import simulate
from study import CONFIG, SPACE, Assessment

HERE = Path(__file__).resolve().parent
RESULTS = HERE.parents[2] / "reports/aeb-behind/results.csv"


def runs_of_crumple(crumple, figures):
    """Runs crumple with the systems of the figures, and returns {motion after an impact: {system: Drives}}."""
    systems = list(dict.fromkeys(figure["controller"] for figure in figures))
    draws = tomllib.loads(CONFIG.read_text())["draws"]
    runs = {}
    with tempfile.TemporaryDirectory() as folder:
        for after_collision in ("hold", "coast"):
            assessment = Assessment(after_collision, {"emergencies": SPACE.read_text()}, systems, draws,
                                    after_collision, "truth")
            assessment.run(crumple, Path(folder))
            runs[after_collision] = {system: drives for (_, system), drives in assessment.read(Path(folder)).items()}
    return runs


def count(drives, figure):
    """Returns {class: (collisions, emergencies)} of a figure."""
    counts = {}
    for kind in ("light", "heavy"):
        hits = [hit for hit, stratum in zip(getattr(drives, figure["measure"]), drives.strata)
                if stratum == (figure["follower"], kind)]
        counts[kind] = (int(sum(hits)), len(hits))
    return counts


def committed(figure):
    """Returns {class: (collisions, emergencies)} of the results that the page has."""
    column = {"ahead": "hits_ahead", "behind": "hit_from_behind"}[figure["measure"]]
    with open(RESULTS, newline="") as file:
        rows = list(csv.DictReader(file))
    wanted = {"space": "emergencies", "estimator": "truth", "system": figure["controller"],
              "follower": figure["follower"], "after_collision": figure["after_collision"]}
    rows = [row for row in rows if all(row[name] == value for name, value in wanted.items())]
    return {row["class"]: (int(row[column]), int(row["emergencies"])) for row in rows}


def mean(counts):
    """Returns the mean share of both classes, and its variance."""
    shares = [(hits / count, count) for hits, count in counts.values()]
    return sum(share for share, _ in shares) / 2, sum(
        max(share * (1 - share), 1 / count) / count for share, count in shares) / 4


def compare_with_page(figure, counts):
    """Refuses figures of crumple that the page does not have."""
    if counts != committed(figure):
        sys.exit(f"error: crumple's collisions of {figure} are {counts}, those of {RESULTS.name} {committed(figure)}")


def main(crumple, is_written):
    """Runs crumple and the second simulator, and compares their figures.

    Writes them to `second.csv` if `is_written`; otherwise they must be those of that file.
    """
    config = tomllib.loads((HERE / "questions.toml").read_text())["second"]
    space = tomllib.loads(SPACE.read_text())
    quantile = NormalDist().inv_cdf(0.5 + config["confidence"] / 2)
    lines = ["controller,follower,after_collision,measure,crumple_percent,second_percent,difference,interval"]
    runs, known, outside = runs_of_crumple(crumple, config["figures"]), {}, 0
    for figure in config["figures"]:
        key = figure["controller"], figure["follower"], figure["after_collision"]
        if key not in known:
            known[key] = simulate(figure, config["seed"], config["emergencies"], space)
        counts = count(runs[key[2]][key[0]], figure)
        compare_with_page(figure, counts)
        (own, own_variance), (theirs, their_variance) = mean(known[key][figure["measure"]]), mean(counts)
        limit = quantile * math.sqrt(own_variance + their_variance)
        outside += abs(own - theirs) > limit
        lines.append(",".join([f'"{key[0]}"', *key[1:], figure["measure"], *(
            f"{100 * value:.1f}" for value in (theirs, own, own - theirs, limit))]))
        print(lines[-1], flush=True)
    path = RESULTS.with_name("second.csv")
    text = "\n".join(lines) + "\n"
    if is_written:
        path.write_text(text)
    elif path.read_text() != text:
        sys.exit(f"error: {path} differs")
    if outside:
        sys.exit(f"error: {outside} of {len(config['figures'])} figures differ by more than their interval")
    print(f"All {len(config['figures'])} figures of crumple and of the second simulator agree.")
