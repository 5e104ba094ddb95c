"""Measures `crumple.monitor` and rtamt on the same formulas and traces.

`RAYON_NUM_THREADS=1 python benches/monitor.py [SAMPLES]`; needs rtamt. Prints processor times; those of rtamt exclude
parsing.
"""

import sys
import time
import warnings

import numpy as np
import rtamt

import crumple

FORMULAS = (
    "always[0,10] (x > 1)",
    "always[0,10] (eventually[0,5] (x > 1))",
    "always[0,10] ((x > 1) implies (eventually[0,5] (y > 0)))",
    "(x > 1) until[2,8] (y > 0)",
)


def best_time_s(work):
    """Returns the shortest of five times, in seconds."""
    best = float("inf")
    for _ in range(5):
        start_s = time.process_time()
        work()
        best = min(best, time.process_time() - start_s)
    return best


def main(samples):
    """Prints a line for each formula."""
    numbers = np.random.default_rng(0)
    signals = {name: numbers.uniform(-5, 5, samples) for name in "xy"}
    many = {name: numbers.uniform(-5, 5, (1000, samples)) for name in "xy"}
    data = {"time": list(range(samples)), **{name: list(values) for name, values in signals.items()}}
    print(f"{samples} samples, milliseconds a trace: rtamt, crumple alone (ratio), crumple with 1000 at once (ratio)")
    for text in FORMULAS:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            spec = rtamt.StlDiscreteTimeSpecification()
            for name in signals:
                spec.declare_var(name, "float")
            spec.spec = text
            spec.parse()
            theirs = best_time_s(lambda spec=spec: spec.evaluate(data))
        alone = (
            best_time_s(lambda text=text: [crumple.monitor(text, signals, over_time=True) for _ in range(100)]) / 100
        )
        batch = best_time_s(lambda text=text: crumple.monitor(text, many, over_time=True)) / 1000
        print(
            f"  {text:<58} {1e3 * theirs:8.3f}  {1e3 * alone:7.4f} ({theirs / alone:5.0f})"
            f"  {1e3 * batch:7.4f} ({theirs / batch:5.0f})"
        )


main(int(sys.argv[1]) if len(sys.argv) > 1 else 1000)
