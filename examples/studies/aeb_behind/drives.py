"""Drives of the study: their strata and their statistics."""

import csv
import math
from collections import defaultdict
from statistics import NormalDist

CLASSES = ("light", "heavy")
FOLLOWERS = ("human", "idm", "acc-aeb", "baseline")
SCALE = {"ahead": 100, "behind": 100, "any": 100, "harm": 1000}


class Drives:
    """Results of one system in one space: one entry per emergency, in the same order for every system."""

    def __init__(self, rows):
        self.strata = [tuple(row["follower"].split()) for row in rows]
        # A vehicle that is pushed into the one ahead does not count as hitting it.
        self.ahead = [float(row["ahead_mps"] != "" and row["pushed"] == "0") for row in rows]
        self.behind = [float(row["behind_mps"] != "") for row in rows]
        self.any = [max(pair) for pair in zip(self.ahead, self.behind)]
        self.harm = [float(row["harm"]) for row in rows]
        self.activations = [float(row["activates"] == "1") for row in rows]


def read(path):
    """Returns {(space, system): Drives} of a table `runs.csv`."""
    rows = defaultdict(list)
    with open(path, newline="") as file:
        for row in csv.DictReader(file):
            rows[row["space"], row["controller"]].append(row)
    return {key: Drives(of) for key, of in rows.items()}


def weights(followers, lorry_percent):
    """Returns the weight of each stratum: types of followers alike, and a share of lorries."""
    classes = dict(zip(CLASSES, (1 - lorry_percent / 100, lorry_percent / 100)))
    return {(driver, kind): share / len(followers) for driver in followers for kind, share in classes.items() if share}


def moments(values):
    """Returns the mean of some values, and the variance of this mean."""
    n = len(values)
    mean = sum(values) / n
    return mean, sum((value - mean) ** 2 for value in values) / (n * max(n - 1, 1))


class Stratified:
    """Values of the same emergencies, by stratum, so that each weighting needs only their moments."""

    def __init__(self, strata, values, measure, has_floor=True):
        parts = defaultdict(list)
        for stratum, value in zip(strata, values):
            parts[stratum].append(SCALE[measure] * value)
        self.moments = {stratum: moments(part) for stratum, part in parts.items()}
        # The variance of a stratum without any event is that of one event.
        if has_floor and measure != "harm":
            self.moments = {stratum: (mean, max(variance, (SCALE[measure] / len(parts[stratum])) ** 2))
                            for stratum, (mean, variance) in self.moments.items()}

    def mean(self, of):
        """Returns the weighted mean and its standard error."""
        mean = sum(weight * self.moments[stratum][0] for stratum, weight in of.items())
        return mean, math.sqrt(sum(weight ** 2 * self.moments[stratum][1] for stratum, weight in of.items()))


def level(drives, measure):
    """Returns a measure of some drives."""
    return Stratified(drives.strata, getattr(drives, measure), measure)


def change(after, before, measure):
    """Returns the change of a measure in the same emergencies."""
    pairs = zip(getattr(after, measure), getattr(before, measure))
    return Stratified(after.strata, [own - other for own, other in pairs], measure)


def quantile(error_probability):
    """Returns the two-sided quantile of the normal distribution."""
    return NormalDist().inv_cdf(1 - error_probability / 2)


def interval(mean_and_error, z):
    """Returns the mean and its interval."""
    mean, error = mean_and_error
    return mean, mean - z * error, mean + z * error
