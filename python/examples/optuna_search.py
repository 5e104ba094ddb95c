"""Searches for failures with Optuna, and compares it with crumple's methods.

pip install ".." optuna
python optuna_search.py 10 300
"""

import math
import sys

import optuna

import crumple

BATCH = 8


class OptunaSearch:
    """Search by a sampler of Optuna, which proposes eight points at a time."""

    def __init__(self, dimension, seed):
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        sampler = optuna.samplers.TPESampler(seed=seed, n_startup_trials=2 * dimension, constant_liar=True)
        self.study = optuna.create_study(sampler=sampler)
        self.names = [f"x{index}" for index in range(dimension)]
        self.trials = []

    def ask(self):
        """Returns the next points."""
        self.trials = [self.study.ask() for _ in range(BATCH)]
        return [[trial.suggest_float(name, 0.0, 1.0) for name in self.names] for trial in self.trials]

    def tell(self, robustness):
        """Passes the robustness on; Optuna takes finite numbers only."""
        for trial, value in zip(self.trials, robustness, strict=False):
            self.study.tell(trial, max(-1e9, min(1e9, 1e9 if math.isnan(value) else value)))


def main(seeds, budget):
    """Compares Optuna with two methods of crumple and returns the comparison."""
    method = crumple.SearchMethod(OptunaSearch, name="optuna")
    compared = crumple.compare("idm", "high-risk", methods=[method, "auto", "uniform"], seeds=seeds, budget=budget)
    print(compared)
    return compared


if __name__ == "__main__":
    main(*(int(word) for word in sys.argv[1:3]) if len(sys.argv) > 2 else (10, 300))
