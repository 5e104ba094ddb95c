#!/usr/bin/env python3
"""Recomputes the figures of the study of rear-end collisions from its raw runs. Needs only Python 3.9.

    aeb_behind.py REPORT [FIGURES]      tables of the runs in REPORT/runs.csv, compared with REPORT/assessment.json;
                                        draws the Pareto fronts into the folder FIGURES
    aeb_behind.py sensitivity CRUMPLE   runs the study with one assumption changed at a time
"""

import csv
import json
import math
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path

HERE = Path(__file__).parent
REFERENCE = "emergency-brake,ttc_s=0.001"


def binomial_cdf(k, n, p):
    """Returns P(X <= k)."""
    if p <= 0 or k >= n:
        return 1.0
    if p >= 1:
        return 0.0
    logs = math.lgamma(n + 1)
    return min(1.0, sum(
        math.exp(logs - math.lgamma(i + 1) - math.lgamma(n - i + 1) + i * math.log(p) + (n - i) * math.log1p(-p))
        for i in range(k + 1)))


def clopper_pearson(k, n, tail=0.025):
    """Returns the exact 95 % interval of a share, by bisection."""
    if n == 0:
        return 0.0, 1.0

    def solve(is_above):
        low, high = 0.0, 1.0
        for _ in range(40):
            middle = (low + high) / 2
            low, high = (low, middle) if is_above(middle) else (middle, high)
        return (low + high) / 2

    lower = 0.0 if k == 0 else solve(lambda p: 1 - binomial_cdf(k - 1, n, p) > tail)
    upper = 1.0 if k == n else solve(lambda p: binomial_cdf(k, n, p) < tail)
    return lower, upper


class Group:
    """Effects of one controller in drives with one kind of follower, against the drives of the reference."""

    def __init__(self, runs, reference):
        ahead = [bool(run["ahead_mps"]) for run in runs]
        behind = [bool(run["behind_mps"]) for run in runs]
        ahead_0 = [bool(run["ahead_mps"]) for run in reference]
        behind_0 = [bool(run["behind_mps"]) for run in reference]
        active = [run["activates"] == "1" for run in runs]
        harm = [float(run["harm"]) for run in runs]
        n = self.drives = len(runs)
        self.activations = sum(active)
        self.ahead, self.behind = sum(ahead), sum(behind)
        self.only_behind = sum(b and not a for a, b in zip(ahead, behind))
        avoided = [b and not a for a, b in zip(ahead, ahead_0)]
        self.avoided = sum(avoided)
        self.avoided_active = sum(a and b for a, b in zip(active, avoided))
        caused = [a and not b for a, b in zip(behind, behind_0)]
        self.caused = sum(caused)
        self.prevented_active = sum(a and c and not b for a, b, c in zip(active, behind, behind_0))
        self.caused_active = sum(a and c for a, c in zip(active, caused))
        self.harm = 1000 * sum(harm) / n
        self.harm_error = 1960 * math.sqrt(sum((1 * h - self.harm / 1000) ** 2 for h in harm) / n / n)
        difference = [float(a["harm"]) - float(b["harm"]) for a, b in zip(runs, reference)]
        mean = sum(difference) / n
        self.harm_saved = 0.0 - 1000 * mean
        self.harm_saved_error = 1960 * math.sqrt(sum((d - mean) ** 2 for d in difference) / n / n)
        self.harm_saved_active = 100 * sum(-d for d, a in zip(difference, active) if a) / max(1, self.activations)


def read_groups(path):
    """Returns {(space, follower): {controller: Group}}, the avoidability by group, and the runs."""
    with open(path, newline="") as file:
        rows = list(csv.DictReader(file))
    runs = defaultdict(lambda: defaultdict(list))
    for row in rows:
        for follower in ("all", row["follower"], row["follower"].split()[0] + " (any class)"):
            runs[row["space"], follower][row["controller"]].append(row)
    groups, avoidable = {}, {}
    for key, by_controller in runs.items():
        reference = next(iter(by_controller.values()))
        groups[key] = {name: Group(rows, reference) for name, rows in by_controller.items()}
        decided = [row["avoidable"] for row in reference if row["avoidable"]]
        avoidable[key] = (decided.count("yes"), decided.count("no"), len(decided))
    return groups, avoidable


def compare(groups, avoidable, report):
    """Compares the counts with those of the assessment. Returns the number of compared figures."""
    compared = 0

    def equal(what, own, stated, tolerance=0.0):
        nonlocal compared
        compared += 1
        if abs(own - stated) > tolerance:
            sys.exit(f"error: {what}: {own} from the runs, and the report states {stated}")

    for stated in report["harm"]["groups"]:
        key = (stated["space"]["name"], stated["follower"])
        for own, theirs in zip(avoidable[key], stated["avoidable"]):
            equal(f"{key} avoidable", own, theirs)
        for one in stated["controllers"]:
            own, what = groups[key][one["controller"]], f"{key} {one['controller']}"
            equal(what + " activations", own.activations, one["activations"])
            equal(what + " avoided", own.avoided, one["avoided"])
            equal(what + " caused", own.caused, one["caused"])
            equal(what + " harm", own.harm, one["harm_per_1000"][0], 0.0006)
            equal(what + " error of harm", own.harm_error, one["harm_per_1000"][1], 0.0006)
            for field, count, of in [("ahead_percent", own.ahead, own.drives),
                                     ("behind_percent", own.behind, own.drives),
                                     ("caused_per_100_activations", own.caused_active, own.activations)]:
                low, high = clopper_pearson(count, of)
                equal(f"{what} {field}", 100 * count / max(of, 1), one[field]["observed"], 0.006)
                equal(f"{what} {field}, lower", 100 * low, one[field]["lower"], 0.011)
                equal(f"{what} {field}, upper", 100 * high, one[field]["upper"], 0.011)
    return compared


def percent(count, of, scale=100.0):
    """Returns a share with its interval, in units of 1/scale."""
    low, high = clopper_pearson(count, of)
    return f"{scale * count / max(of, 1):.1f} ({scale * low:.1f} to {scale * high:.1f})"


def print_group(key, controllers, passing, rate):
    print(f"\n### {key[0]}, follower: {key[1]}, {next(iter(controllers.values())).drives} drives\n")
    print("| controller | passes S7.1 | hits leader, % | hit from behind, % | only from behind, % | harm per 1000 "
          "| harm saved per 1000 |\n|---|---|---|---|---|---|---|")
    for name, one in controllers.items():
        shares = " | ".join(percent(count, one.drives) for count in (one.ahead, one.behind, one.only_behind))
        print(f"| {name} | {passing.get(name, '–')} | {shares} | {one.harm:.1f} ± {one.harm_error:.1f} "
              f"| {one.harm_saved:.1f} ± {one.harm_saved_error:.1f} |")
    if key[1] != "all":
        return
    print(f"\n| controller | activations | avoided ahead per 100 | caused behind per 100 | prevented behind per 100 "
          "| harm saved per 100 | avoided ahead per 1000 h | caused behind per 1000 h | harm saved per 1000 h |\n"
          + "|---" * 9 + "|")
    for name, one in controllers.items():
        counts = (one.avoided_active, one.caused_active, one.prevented_active)
        active = [percent(count, one.activations) for count in counts]
        hourly = [percent(count, one.drives, 1000 * rate) for count in (one.avoided, one.caused)]
        print(f"| {name} | {one.activations} | {' | '.join(active)} | {one.harm_saved_active:.2f} "
              f"| {' | '.join(hourly)} | {rate * one.harm_saved:.2f} ± {rate * one.harm_saved_error:.2f} |")


def print_followers(groups):
    """Prints what the brakes of the sensitivity table cause and save, by driver and class of the follower."""
    print("\n### By follower\n\n| follower | drives | " + " | ".join(
        f"{name}: caused per 100 | saved per 1000" for name in COMPARED[1:]) + " |\n" + "|---" * 8 + "|")
    for (_, follower), controllers in sorted(groups.items()):
        if follower.endswith((" light", " heavy")):
            brakes = [controllers[name] for name in COMPARED[1:] if name in controllers]
            cells = [f"{percent(one.caused_active, one.activations)} "
                     f"| {one.harm_saved:.1f} ± {one.harm_saved_error:.1f}" for one in brakes]
            drives = next(iter(controllers.values())).drives
            print(f"| {follower} | {drives} | " + " | ".join(cells) + " |")


def front(points):
    """Returns the names of the points that no other point beats in both coordinates."""
    beats = lambda a, b: a[0] <= b[0] and a[1] <= b[1] and a != b
    return [name for name, own in points.items() if not any(beats(other, own) for other in points.values())]


def draw(path, title, note, controllers, passing, limit):
    """Draws collisions ahead against collisions behind, in percent of the drives."""
    width, height, left, top, size = 760, 560, 70, 60, (470, 400)
    points = {name: (100 * one.behind / one.drives, 100 * one.ahead / one.drives)
              for name, one in controllers.items()}
    reach = [10 * math.ceil(0.105 * max(1.0, *(point[axis] for point in points.values()))) for axis in (0, 1)]
    x = lambda value: left + size[0] * value / reach[0]
    y = lambda value: top + size[1] * (1 - value / reach[1])
    out = [f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {width} {height}" '
           'font-family="sans-serif" font-size="12">', f'<rect width="{width}" height="{height}" fill="white"/>',
           f'<text x="{left}" y="24" font-size="16">{title}</text>',
           f'<text x="{left}" y="44" fill="#555">{note}</text>',
           f'<rect x="{left}" y="{top}" width="{size[0]}" height="{size[1]}" fill="none" stroke="#888"/>']
    for axis in (0, 1):
        for value in range(0, reach[axis] + 1, 10 if reach[axis] <= 60 else 20):
            if axis == 0:
                place = f'x="{x(value)}" y="{top + size[1] + 18}" text-anchor="middle"'
            else:
                place = f'x="{left - 8}" y="{y(value) + 4}" text-anchor="end"'
            out.append(f"<text {place}>{value}</text>")
    out.append(f'<text x="{left + size[0] / 2}" y="{top + size[1] + 40}" text-anchor="middle">'
               'Hit from behind (% of emergencies)</text>')
    out.append(f'<text transform="translate(20 {top + size[1] / 2}) rotate(-90)" text-anchor="middle">'
               'Hits the vehicle ahead (% of emergencies)</text>')
    best = sorted(front(points), key=lambda name: points[name])
    path_of = " ".join(f"{x(points[name][0]):.1f},{y(points[name][1]):.1f}" for name in best)
    out.append(f'<polyline points="{path_of}" fill="none" stroke="#0060a0" stroke-width="1.5"/>')
    if limit is not None:
        out.append(f'<text x="{left + 6}" y="{top + size[1] + 62}" fill="#555">{limit}</text>')
    taken = [(x(own[0]), y(own[1])) for own in points.values()]
    around = ((0, -15), (0, 15), (17, -10), (-17, -10), (17, 10), (-17, 10))
    places = [(far * dx, far * dy) for far in (1, 2, 3) for dx, dy in around]
    for number, name in enumerate(points, 1):
        px, py = (x(points[name][0]), y(points[name][1]))
        free = [(px + dx, py + dy) for dx, dy in places
                if all(abs(px + dx - tx) > 15 or abs(py + dy - ty) > 11 for tx, ty in taken)]
        lx, ly = (free or [(px, py - 15)])[0]
        taken.append((lx, ly))
        color = {"yes": "#0060a0", "no": "#c04000"}.get(passing.get(name), "#555")
        out.append(f'<circle cx="{px:.1f}" cy="{py:.1f}" r="4" fill="{color}"/>')
        out.append(f'<line x1="{px:.1f}" y1="{py:.1f}" x2="{lx:.1f}" y2="{ly:.1f}" stroke="{color}" '
                   'stroke-width="0.4"/>')
        out.append(f'<text x="{lx:.1f}" y="{ly + 4:.1f}" text-anchor="middle" fill="{color}">{number}</text>')
        label = name.replace("emergency-brake", "brake").replace("_mps2", "").replace("_s", "")
        out.append(f'<text x="{left + size[0] + 16}" y="{top + 12 + 17 * number}" fill="{color}">'
                   f'{number} {label}</text>')
    out.append(f'<text x="{left + size[0] + 16}" y="{top}" fill="#555">blue: passes, red: fails S7.1</text>')
    out.append(f'<text x="{left + size[0] + 16}" y="{top + 14}" fill="#555">of fmvss-127 as modelled</text></svg>')
    Path(path).write_text("\n".join(out) + "\n")


def suite_verdicts(report):
    """Returns whether each controller passes the lead-vehicle clause S7.1 of the suite."""
    verdicts = {}
    for suite in report.get("suites", {}).get("suites", []):
        for test in suite["tests"]:
            if test["clause"] == "S7.1":
                for name, outcome in zip(suite["controllers"], test["outcomes"]):
                    passes = outcome["passed"] and verdicts.get(name, "yes") == "yes"
                    verdicts[name] = "yes" if passes else "no"
    return verdicts


def show(folder, figures):
    report = json.loads((folder / "assessment.json").read_text())
    groups, avoidable = read_groups(folder / "runs.csv")
    compared = compare(groups, avoidable, report)
    print(f"{compared} figures of the report agree with the runs.")
    passing, rate = suite_verdicts(report), report["harm"]["emergencies_per_hour"]
    print_followers(groups)
    for key, controllers in groups.items():
        yes, no, examined = avoidable[key]
        print_group(key, controllers, passing, rate)
        points = {name: (one.behind, one.ahead) for name, one in controllers.items()}
        print("\nFront:", "; ".join(front(points)))
        if examined:
            print(f"\nNo driver avoids a collision (proved): {percent(no, examined)} %; an escape was found: "
                  f"{percent(yes, examined)} %; undecided: {examined - yes - no} of {examined}.")
        if figures and (key[1] == "all" or "(any" in key[1]):
            figures.mkdir(parents=True, exist_ok=True)
            slug = key[1].split()[0]
            unavoidable = f"Collision of any kind proved unavoidable: {percent(no, examined)} % of emergencies"
            limit = unavoidable if examined else None
            draw(figures / f"{slug}.svg", "Collisions ahead and behind, follower: " + key[1],
                 f"{next(iter(controllers.values())).drives} simulated emergencies; the line is the Pareto front",
                 controllers, passing, limit)


def time_gaps(ln_mean, ln_deviation):
    return "ln_mean = 0.405, ln_deviation = 0.5", f"ln_mean = {ln_mean}, ln_deviation = {ln_deviation}"


# Assumption, and the replacements in the text of the space and of the list of controllers.
HUMAN = 'driver = "human"'
CHANGES = {
    "base case": [],
    "reaction 1.0 s": [(HUMAN, "driver.human = { reaction_s = 1.0, surprise_s = 1.0 }")],
    "reaction 2.0 s": [(HUMAN, "driver.human = { reaction_s = 2.0, surprise_s = 2.0 }")],
    "perception 0.001 rad/s": [(HUMAN, "driver.human = { looming_rad_per_s = 0.001 }")],
    "perception 0.04 rad/s": [(HUMAN, "driver.human = { looming_rad_per_s = 0.04 }")],
    "braking level 4.3 m/s²": [(HUMAN, "driver.human = { brake_mps2 = 4.3 }")],
    "braking level 6.9 m/s²": [(HUMAN, "driver.human = { brake_mps2 = 6.9 }")],
    "no glances": [(HUMAN, "driver.human = { glance_per_s = 0.0 }")],
    "0.3 glances per second": [(HUMAN, "driver.human = { glance_per_s = 0.3 }")],
    "glances of 1.5 s": [(HUMAN, "driver.human = { glance_s = 1.5 }")],
    "follower has an emergency brake": [(HUMAN, "driver.human = { aeb_ttc_s = 1.4 }")],
    "time gap behind 1.0 s": [('"vehicles[2].time_gap_s"\nunit = "s"\ndistribution.log-normal = { ln_mean = 0.405',
                               '"vehicles[2].time_gap_s"\nunit = "s"\ndistribution.log-normal = { ln_mean = 0.0')],
    "time gap behind 2.0 s": [('"vehicles[2].time_gap_s"\nunit = "s"\ndistribution.log-normal = { ln_mean = 0.405',
                               '"vehicles[2].time_gap_s"\nunit = "s"\ndistribution.log-normal = { ln_mean = 0.693')],
    "both time gaps as in 20 NGSIM events": [time_gaps(0.385, 0.408)],
    "both time gaps as in OpenACC, short setting": [time_gaps(0.370, 0.415)],
    "both time gaps as in OpenACC, long setting": [time_gaps(0.985, 0.222)],
    "time gap ahead 1.0 s": [('"vehicles[1].time_gap_s"\nunit = "s"\ndistribution.log-normal = { ln_mean = 0.405',
                              '"vehicles[1].time_gap_s"\nunit = "s"\ndistribution.log-normal = { ln_mean = 0.0')],
    "followers are cars": [('values = ["light", "heavy"]', 'values = ["light"]')],
    "followers are lorries": [('values = ["light", "heavy"]', 'values = ["heavy"]'),
                              ('class = "light"\nposition_m = 0.0', 'class = "heavy"\nposition_m = 0.0')],
    "leader brakes less (mean share 0.35)": [("mean = 0.5, deviation = 0.2", "mean = 0.35, deviation = 0.2")],
    "leader brakes more (mean share 0.7)": [("mean = 0.5, deviation = 0.2", "mean = 0.7, deviation = 0.2")],
    "wet road (mean friction 0.6)": [("mean = 1.0, deviation = 0.2", "mean = 0.6, deviation = 0.2")],
    "reference does not brake after its impact": [(REFERENCE, "emergency-brake,ttc_s=0")],
}
COMPARED = [REFERENCE, "emergency-brake", "emergency-brake,ttc_s=3", "predictive"]


def sensitivity(crumple):
    space = (HERE / "emergencies.toml").read_text()
    start = space.index('[[parameters]]\nname = "follower"\n')
    space = space[:start] + space[space.index("[[parameters]]", start + 5):]
    print("| assumption | " + " | ".join(f"{name}: {what}" for name in COMPARED[1:]
                                          for what in ("caused per 100", "harm saved per 1000")) + " |")
    print("|---|" + "---|---|" * (len(COMPARED) - 1))
    for assumption, changes in CHANGES.items():
        text, names = space, json.dumps(COMPARED)
        for old, new in changes:
            if old not in text + names:
                sys.exit(f"error: {assumption}: `{old}` is not in the study")
            text, names = text.replace(old, new), names.replace(old, new)
        with tempfile.TemporaryDirectory() as folder:
            folder = Path(folder)
            (folder / "space.toml").write_text(text)
            (folder / "study.toml").write_text(
                f"version = 1\ncontrollers = {names}\npaper = false\ndistributions = [\"space.toml\"]\n"
                "draws = 2000\neveryday_draws = 0\nsearch = { spaces = [] }\nrates = { runs = 0 }\ncertificates = []\n"
                "harm = { emergencies_per_hour = 0.1 }\n")
            subprocess.run([crumple, "assess", "study.toml", "--out", "report"], cwd=folder, check=True,
                           stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            groups, _ = read_groups(folder / "report" / "runs.csv")
        controllers = next(own for key, own in groups.items() if key[1] == "all")
        cells = [cell for name in COMPARED[1:] for cell in (
            percent(controllers[name].caused_active, controllers[name].activations),
            f"{controllers[name].harm_saved:.2f} ± {controllers[name].harm_saved_error:.2f}")]
        print(f"| {assumption} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    if sys.argv[1:2] == ["sensitivity"] and len(sys.argv) == 3:
        sensitivity(Path(sys.argv[2]).resolve())
    elif len(sys.argv) in (2, 3) and (Path(sys.argv[1]) / "runs.csv").is_file():
        show(Path(sys.argv[1]), Path(sys.argv[2]) if len(sys.argv) == 3 else None)
    else:
        sys.exit(__doc__)
