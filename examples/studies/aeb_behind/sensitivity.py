"""The study with one assumption changed at a time, with human drivers behind."""

from drives import change, interval, quantile, weights
from page import LORRY_PERCENT, cell, check_tables, table
from study import BRAKE, CONFORMING, HUMAN, NONE, Assessment, space_with_follower
from time_gaps import histogram

DRAWS = 1000


def gaps(vehicle, column):
    """Returns the replacement of the time gap of a vehicle."""
    start = f'field = "vehicles[{vehicle}].time_gap_s"\nunit = "s"\n'
    return start + histogram("all"), start + "nominal = 2.0\n" + histogram(column)


# Assumption: settings of the driver behind, estimator, and the replacements in the text of the space.
CHANGES = {
    "base case (leader's mean braking 50 % of its limit)": ("", "kalman", []),
    "brake observes the true state": ("", "truth", []),
    "reaction 1.0 s": ("reaction_s=1.0,surprise_s=1.0", "kalman", []),
    "reaction 2.0 s": ("reaction_s=2.0,surprise_s=2.0", "kalman", []),
    "perception 0.001 rad/s": ("looming_rad_per_s=0.001", "kalman", []),
    "perception 0.04 rad/s": ("looming_rad_per_s=0.04", "kalman", []),
    "braking level 4.3 m/s²": ("brake_mps2=4.3", "kalman", []),
    "braking level 6.9 m/s²": ("brake_mps2=6.9", "kalman", []),
    "0.3 glances per second": ("glance_per_s=0.3", "kalman", []),
    "followers have a brake from 1.4 s": ("aeb_ttc_s=1.4", "kalman", []),
    "gaps behind: short setting": ("", "kalman", [gaps(2, "short")]),
    "gaps behind: long setting": ("", "kalman", [gaps(2, "long")]),
    "gaps behind: manual driving": ("", "kalman", [gaps(2, "manual")]),
    "gaps ahead: manual driving": ("", "kalman", [gaps(1, "manual")]),
    "leader's mean braking 35 %": ("", "kalman", [("mean = 0.5, deviation = 0.2",
                                                             "mean = 0.35, deviation = 0.2")]),
    "leader's mean braking 70 %": ("", "kalman", [("mean = 0.5, deviation = 0.2",
                                                            "mean = 0.7, deviation = 0.2")]),
    "wet road (mean friction 0.6)": ("", "kalman", [("mean = 1.0, deviation = 0.2", "mean = 0.6, deviation = 0.2")]),
    "sensors: latency 0.2 s, range 60 m": ("", "kalman", [
        ("duration_s = 25.0\n", "duration_s = 25.0\nsensors.faults = { latency_s = 0.2, range_m = 60.0 }\n")]),
}


def assessments():
    """Returns the assessment of each assumption."""
    made = {}
    for index, (assumption, (settings, estimator, replacements)) in enumerate(CHANGES.items()):
        space = space_with_follower("changed", "human," + settings if settings else "human", *replacements)
        made[assumption] = Assessment(f"sensitivity-{index:02}", {"changed": space}, [NONE, BRAKE, HUMAN, CONFORMING],
                                      DRAWS, "hold", estimator)
    return made


def run(crumple, folder):
    for assumption, assessment in assessments().items():
        assessment.run(crumple, folder)
        print(assumption, flush=True)


def check(page, folder, is_written):
    """Compares the table with the runs, or writes it."""
    of, rows = weights(["human"], LORRY_PERCENT), []
    for assumption, assessment in assessments().items():
        drives = {system: of_system for (_, system), of_system in assessment.read(folder).items()}
        cells = [cell(interval(change(drives[after], drives[before], measure).mean(of), quantile(0.05)), True)
                 for before, after in ((HUMAN, CONFORMING), (NONE, BRAKE)) for measure in ("behind", "harm")]
        rows.append((assumption, *cells))
    made = table(["assumption", "human + brake 2 s: behind", "human + brake 2 s: injuries", "brake 2 s: behind",
                  "brake 2 s: injuries"], rows)
    check_tables(page, {"sensitivity": made}, is_written)
