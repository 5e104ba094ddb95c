"""Computes the quantiles of recorded time gaps of the study: `time-gaps.csv`. Needs only Python 3.11.

    python3 examples/studies/aeb_behind/time_gaps.py FOLDER            # compares time-gaps.csv with the recordings
    python3 examples/studies/aeb_behind/time_gaps.py FOLDER --write    # writes it

FOLDER has the 50 recordings of OpenACC's ZalaZONE campaign that `../openacc/fetch.py` collects. A drive is one car
behind the recorded car ahead of it, in one file, with at least 30 s above 5 m/s. Its time gap is the recorded gap
between the bumpers, divided by its speed. Drives whose median is above 4.5 s are left out: that car does not follow.
Each drive has the same weight: the table has the quantiles of the pooled percentiles of all drives.
"""

import csv
import statistics
import sys
from pathlib import Path

TABLE = Path(__file__).with_name("time-gaps.csv")
LEVELS = [1, *range(5, 100, 5), 99]
MIN_SPEED_MPS, MIN_SAMPLES, MAX_MEDIAN_S = 5.0, 300, 4.5
# Lines "ACC" and "Distance_setting" of the recordings, and the column of the table.
SETTINGS = {("1", "S"): "short", ("1", "L"): "long", ("0", ""): "manual"}


def read_drives(path):
    """Returns the column of a recording, and the time gaps of its cars, in seconds."""
    with open(path, newline="") as file:
        rows = csv.reader(file)
        head = {}
        for columns in rows:
            if columns[0] == "Time":
                break
            head[columns[0]] = columns[1:]
        place = {name: index for index, name in enumerate(columns)}
        pairs = [(place[f"Speed{car + 1}"], place[f"IVS{car}"]) for car in range(1, len(columns))
                 if f"IVS{car}" in place and f"Speed{car + 1}" in place]
        gaps = [[] for _ in pairs]
        for row in rows:
            for drive, (speed, gap) in zip(gaps, pairs):
                if row[speed] and row[gap] and float(row[speed]) > MIN_SPEED_MPS and float(row[gap]) > 0:
                    drive.append(float(row[gap]) / float(row[speed]))
    setting = head["ACC"][0], head.get("Distance_setting", [""])[0]
    return SETTINGS.get(setting, "other"), [drive for drive in gaps if len(drive) >= MIN_SAMPLES
                                            and statistics.median(drive) <= MAX_MEDIAN_S]


def table(folder):
    """Returns the text of the table."""
    listed = (Path(__file__).parents[1] / "openacc/files.sha256").read_text().split("\n")
    names = [line.split("/")[-1] for line in listed if line]
    pooled = {"all": [], "short": [], "long": [], "manual": [], "other": []}
    counts = dict.fromkeys(pooled, 0)
    for name in names:
        column, drives = read_drives(next(folder.rglob(name)))
        for drive in drives:
            for key in ("all", column):
                pooled[key] += statistics.quantiles(drive, n=100)
                counts[key] += 1
    columns = ["all", "short", "long", "manual"]
    lines = ["level_percent," + ",".join(f"{name}_s" for name in columns),
             "drives," + ",".join(str(counts[name]) for name in columns)]
    quantiles = {name: statistics.quantiles(pooled[name], n=100) for name in columns}
    lines += [f"{level}," + ",".join(f"{quantiles[name][level - 1]:.2f}" for name in columns) for level in LEVELS]
    return "\n".join(lines) + "\n"


def read_table():
    """Returns {column: quantiles in seconds} of the committed table."""
    with open(TABLE, newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["level_percent"] != "drives"]
    return {name[:-2]: [float(row[name]) for row in rows] for name in rows[0] if name.endswith("_s")}


def histogram(column):
    """Returns the distribution of a column, as a line of a space."""
    weights = [after - before for before, after in zip(LEVELS, LEVELS[1:])]
    edges = ", ".join(f"{edge:g}" for edge in read_table()[column])
    return f"distribution.histogram = {{ edges = [{edges}], weights = [{', '.join(map(str, weights))}] }}"


if __name__ == "__main__":
    if len(sys.argv) not in (2, 3):
        sys.exit(__doc__)
    text = table(Path(sys.argv[1]))
    if "--write" in sys.argv:
        TABLE.write_text(text)
    elif TABLE.read_text() != text:
        sys.exit(f"error: {TABLE} does not state the quantiles of the recordings")
