"""The study with one assumption changed at a time."""

import json
import math
import subprocess
import sys
from pathlib import Path

from drives import ASSISTED, CHANGED, COASTING, EARLY, HUMAN, REFERENCE, label, read_groups
from figures import check_page, signed, table

# Logarithmic means and deviations of 20 events of NGSIM, and of OpenACC with the short and the long setting.
RECORDED_GAPS = [(0.385, 0.408), (0.370, 0.415), (0.985, 0.222)]


def time_gaps(ln_mean, ln_deviation):
    return "ln_mean = 0.405, ln_deviation = 0.5", f"ln_mean = {ln_mean}, ln_deviation = {ln_deviation}"


# Assumption, and the replacements in the text of the space and of the list of controllers.
DRIVER = 'driver = "human"'
CHANGES = {
    "base case": [],
    "reaction 1.0 s": [(DRIVER, "driver.human = { reaction_s = 1.0, surprise_s = 1.0 }")],
    "reaction 2.0 s": [(DRIVER, "driver.human = { reaction_s = 2.0, surprise_s = 2.0 }")],
    "perception 0.001 rad/s": [(DRIVER, "driver.human = { looming_rad_per_s = 0.001 }")],
    "perception 0.04 rad/s": [(DRIVER, "driver.human = { looming_rad_per_s = 0.04 }")],
    "braking level 4.3 m/s²": [(DRIVER, "driver.human = { brake_mps2 = 4.3 }")],
    "braking level 6.9 m/s²": [(DRIVER, "driver.human = { brake_mps2 = 6.9 }")],
    "no glances": [(DRIVER, "driver.human = { glance_per_s = 0.0 }")],
    "0.3 glances per second": [(DRIVER, "driver.human = { glance_per_s = 0.3 }")],
    "glances of 1.5 s": [(DRIVER, "driver.human = { glance_s = 1.5 }")],
    "follower has an emergency brake": [(DRIVER, "driver.human = { aeb_ttc_s = 1.4 }")],
    "time gap behind 1.0 s": [('"vehicles[2].time_gap_s"\nunit = "s"\ndistribution.log-normal = { ln_mean = 0.405',
                               '"vehicles[2].time_gap_s"\nunit = "s"\ndistribution.log-normal = { ln_mean = 0.0')],
    "time gap behind 2.0 s": [('"vehicles[2].time_gap_s"\nunit = "s"\ndistribution.log-normal = { ln_mean = 0.405',
                               '"vehicles[2].time_gap_s"\nunit = "s"\ndistribution.log-normal = { ln_mean = 0.693')],
    "time gaps: 20 NGSIM events": [time_gaps(*RECORDED_GAPS[0])],
    "time gaps: OpenACC, short setting": [time_gaps(*RECORDED_GAPS[1])],
    "time gaps: OpenACC, long setting": [time_gaps(*RECORDED_GAPS[2])],
    "time gap ahead 1.0 s": [('"vehicles[1].time_gap_s"\nunit = "s"\ndistribution.log-normal = { ln_mean = 0.405',
                              '"vehicles[1].time_gap_s"\nunit = "s"\ndistribution.log-normal = { ln_mean = 0.0')],
    "followers are cars": [('values = ["light", "heavy"]', 'values = ["light"]')],
    "followers are lorries": [('values = ["light", "heavy"]', 'values = ["heavy"]'),
                              ('class = "light"\nposition_m = 0.0', 'class = "heavy"\nposition_m = 0.0')],
    "leader brakes less (mean share 0.35)": [("mean = 0.5, deviation = 0.2", "mean = 0.35, deviation = 0.2")],
    "leader brakes more (mean share 0.7)": [("mean = 0.5, deviation = 0.2", "mean = 0.7, deviation = 0.2")],
    "wet road (mean friction 0.6)": [("mean = 1.0, deviation = 0.2", "mean = 0.6, deviation = 0.2")],
}


def sensitivity(crumple, folder, page):
    space = (Path(__file__).parents[1] / "emergencies.toml").read_text()
    start = space.index('[[parameters]]\nname = "follower"\n')
    space = space[:start] + space[space.index("[[parameters]]", start + 5):]
    names = [REFERENCE, COASTING, EARLY, HUMAN, ASSISTED]

    def run(follower, index, changes):
        text = space
        for old, new in changes:
            if old not in text:
                sys.exit(f"error: `{old}` is not in the space")
            text = text.replace(old, new)
        one = folder / f"{follower}-{index:02}"
        one.mkdir(parents=True, exist_ok=True)
        (one / "space.toml").write_text(text.replace(DRIVER, f'driver = "{follower}"'))
        (one / "study.toml").write_text(
            f"version = 1\ncontrollers = {json.dumps(names)}\npaper = false\ndistributions = [\"space.toml\"]\n"
            "draws = 2000\neveryday_draws = 0\nsearch = { spaces = [] }\nrates = { runs = 0 }\ncertificates = []\n"
            "harm = { emergencies_per_hour = 0.1 }\n")
        subprocess.run([crumple, "assess", "study.toml", "--out", "report"], cwd=one, check=True,
                       stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        return read_groups(one / "report" / "runs.csv")["all"]

    rows = []
    for index, (assumption, changes) in enumerate(CHANGES.items()):
        human = run("human", index, changes)
        is_of_driver = any(old == DRIVER for old, _ in changes)
        coasting = None if is_of_driver else run("baseline", index, changes)
        pairs = [(before, after, what, drives)
                 for drives, wanted in ((human, ("behind", "harm")), (coasting, ("harm",)))
                 for before, after in ((HUMAN, ASSISTED), (REFERENCE, EARLY)) for what in wanted]
        cells = lambda pairs: [signed(drives[after].change(drives[before], what)) if drives else "–"
                               for before, after, what, drives in pairs]
        rows.append((assumption, *cells(pairs)))
        if index == 0:
            coasts = [(COASTING if before == REFERENCE else before, *rest) for before, *rest in pairs]
            last = (label(COASTING), *cells(coasts))
    compared = ["human + brake 1.4 s against human", "brake 3 s against no brake"]
    heads = [f"{pair}: {what}" for pair in compared for what in CHANGED]
    heads += [f"`baseline` behind, {pair}: {CHANGED[1]}" for pair in compared]
    print(table(["assumption", *heads], [*rows, last]))
    if page:
        medians = [f"{math.exp(mean):.2f}" for mean, _ in RECORDED_GAPS]
        check_page(page, {}, [
            f"have medians of {medians[0]} and {medians[1]} s; OpenACC with the long setting has {medians[2]} s",
        ], False)
