#!/usr/bin/env python3
"""Converts the CSV file of the tutorial to MDF 4, with one group for each column: `mdf_log.py LOG.csv LOG.mf4`."""

import csv
import sys

import numpy as np
from asammdf import MDF, Signal

# Drives begin at 0 s in the CSV file; a clock of MDF continues.
SECONDS_PER_DRIVE = 100.0


def main(source, target):
    with open(source, newline="") as file:
        rows = list(csv.DictReader(file))
    times = np.array([float(row["t"]) + SECONDS_PER_DRIVE * int(float(row["drive"])) for row in rows])
    with MDF(version="4.10") as log:
        for name in (name for name in rows[0] if name != "t"):
            known = np.array([index for index, row in enumerate(rows) if row[name]])
            values = np.array([float(rows[index][name]) for index in known])
            log.append([Signal(samples=values, timestamps=times[known], name=name)])
        log.save(target, overwrite=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
