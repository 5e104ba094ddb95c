"""Compares the standard errors of the answer about the field with those of a bootstrap of the runs."""

import csv
import itertools
import random
import statistics
from collections import defaultdict

from findings import assisted_systems, combinations, compare, z
from study import HUMAN, QUESTIONS, SEED, SEED_OF_REPETITION, load

SAMPLES = 400


def read_hits(path):
    """Returns {follower and class: places}, and {system: [(hits ahead, hit from behind)]}."""
    strata, hits = defaultdict(list), defaultdict(list)
    with open(path, newline="") as file:
        for row in csv.DictReader(file):
            if row["controller"] == HUMAN:
                strata[row["follower"]].append(len(hits[HUMAN]))
            is_ahead = row["ahead_mps"] != "" and row["pushed"] == "0"
            hits[row["controller"]].append((is_ahead, row["behind_mps"] != ""))
    return strata, hits


def struck(hits, sample, weight, striking):
    """Returns the change of being struck in percent, interpolated to a change of striking, or nothing beyond 3 s."""
    def means(name):
        return [sum(share * sum(hits[name][place][side] for place in sample[stratum]) / len(sample[stratum])
                    for stratum, share in weight.items()) for side in (0, 1)]
    first, below = means(HUMAN), (0.0, 0.0)
    for name in assisted_systems()[1:]:
        above = [own / alone - 1 for own, alone in zip(means(name), first)]
        if below[0] >= striking > above[0]:
            way = (below[0] - striking) / (below[0] - above[0])
            return 100 * (below[1] + way * (above[1] - below[1]))
        below = above
    return None


def print_errors(folder, seed):
    """Prints both standard errors in every combination of assumptions of one run."""
    question = next(one for one in QUESTIONS["questions"] if one["kind"] == "field")
    answers = {key: bounds for (_, key), bounds in compare(question, load(folder, seed))[0].items()}
    chance = random.Random(1)
    for after_collision, estimator, followers, lorries in combinations("field"):
        strata, hits = read_hits(folder / f"{after_collision}-{estimator}/report/runs.csv")
        shares = (("light", 1 - lorries / 100), ("heavy", lorries / 100))
        weight = {f"{follower} {kind}": share / len(followers)
                  for follower, (kind, share) in itertools.product(followers, shares) if share}
        samples = ({stratum: chance.choices(strata[stratum], k=len(strata[stratum])) for stratum in weight}
                   for _ in range(SAMPLES))
        found = [struck(hits, sample, weight, question["striking"]) for sample in samples]
        error = statistics.pstdev(value for value in found if value is not None)
        mean, _, upper = answers[after_collision, estimator, len(followers), lorries]
        delta = (upper - mean) / z()
        print(f"{after_collision} {estimator} {len(followers)} types, {lorries} % lorries: delta method {delta:.2f} %, "
              f"bootstrap {error:.2f} %, ratio {error / delta:.2f}", flush=True)


def main(folder):
    """Prints both standard errors in both runs."""
    print_errors(folder, SEED)
    print_errors(folder / "repeated", SEED_OF_REPETITION)
