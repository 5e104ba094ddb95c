"""Counts braking episodes in OpenACC files independently of crumple, as a reference for `crumple import`.

    python3 tests/brakings.py FILE.csv...

A braking is a loss of more than 1.3 m/s within a second, merged with those that follow within 5 s. It is an episode if
some row of the two seconds before has the speed and spacing of the car behind. It is an episode of a first car if none
of those rows has the speed and spacing of the car ahead.
"""

import csv
import sys

LIMIT, HOLE_S, MERGE_S, BEFORE_S = 1.3, 0.5, 5.0, 2.0


def number(text, lowest, highest):
    """Parses a number; returns None if it is missing or out of range."""
    try:
        value = float(text)
    except ValueError:
        return None
    return value if lowest <= round(value, 3) <= highest else None


def brakings(track):
    """Returns the onset of each braking of one car, with the rows before it."""
    runs, found = [[track[0]]] if track else [], []
    for before, sample in zip(track, track[1:]):
        if round(sample[0] - before[0], 3) > HOLE_S:
            runs.append([])
        runs[-1].append(sample)
    for run in runs:
        last_end, j = None, 0
        for t, v, _ in run:
            while j + 1 < len(run) and run[j + 1][0] < round(t + 1, 3):
                j += 1
            if j + 1 == len(run):
                break
            (t0, v0, _), (t1, v1, _) = run[j], run[j + 1]
            drop = v - (v0 + (v1 - v0) * (t + 1 - t0) / (t1 - t0))
            if drop <= LIMIT + 1e-9:
                continue
            if last_end is None or round(t - last_end, 3) > MERGE_S:
                found.append((t, [row for s, _, row in run if t - BEFORE_S <= round(s, 3) <= t]))
            last_end = t + 1
    return found


def main():
    """Prints the counts of each file."""
    for path in sys.argv[1:]:
        with open(path, newline="") as file:
            rows = list(csv.reader(file))[5:]
        names, rows = rows[0], rows[1:]
        speed = {int(name[5:]): k for k, name in enumerate(names) if name.startswith("Speed")}
        gap = {int(name[3:]): k for k, name in enumerate(names) if name.startswith("IVS")}
        samples, last = [], None
        for row in rows:
            t = round(float(row[0]), 3)
            if last is None or t > last:
                samples, last = [*samples, (t, row)], t

        def follows(car, row):
            """Returns true if the spacing from a car to the one behind it is known, and both drive."""
            return (
                car in speed
                and car + 1 in speed
                and car in gap
                and number(row[speed[car + 1]], 0, 100) is not None
                and number(row[gap[car]], 0.001, 1000) is not None
            )

        print(path.rsplit("/", 1)[-1])
        total = first = 0
        for car in sorted(speed):
            if car not in gap or car + 1 not in speed:
                continue
            track = [(t, round(v, 3), row) for t, row in samples if (v := number(row[speed[car]], 0, 100)) is not None]
            found = [(t, before) for t, before in brakings(track) if any(follows(car, row) for row in before)]
            alone = [
                t
                for t, before in found
                if not any(follows(car - 1, row) and number(row[speed[car - 1]], 0, 100) is not None for row in before)
            ]
            print(f"  car {car}: {len(found)} episodes, {len(alone)} without a known car ahead")
            total, first = total + len(found), first + len(alone)
        print(f"  all: {total}, of first cars {first}")


if __name__ == "__main__":
    main()
