"""Tests of the robustness of STL formulas, in comparison with rtamt."""

import math
import random
import warnings

import numpy as np
import pytest

import crumple

STEP_S = 0.5


def comparison(source):
    name, sign = source.choice("xyz"), source.choice(["<", "<=", ">", ">="])
    return f"({name} {sign} {source.randint(-3, 3)})"


def window(source):
    first = source.randint(0, 4)
    return f"[{first * STEP_S},{(first + source.randint(0, 5)) * STEP_S}]"


def formula(source, depth):
    """Returns a random formula that crumple and rtamt read alike."""
    if depth == 0:
        return comparison(source)
    kind = source.choice(["not", "always", "eventually", "until", "and", "or", "implies"])
    one = formula(source, depth - 1)
    if kind == "not":
        return f"(not {one})"
    other = formula(source, source.randint(0, depth - 1))
    if kind in ("and", "or", "implies"):
        return f"({one} {kind} {other})"
    if kind == "until":
        return f"({one} until{window(source)} {other})"
    return f"({kind}{window(source)} {one})"


def horizon_samples(text):
    """Returns the maximum number of samples that a formula needs: each window adds its end."""
    ends = [float(part.split("]")[0].split(",")[1]) for part in text.split("[")[1:]]
    return round(sum(ends) / STEP_S) + 1


def rtamt_robustness(text, signals):
    rtamt = pytest.importorskip("rtamt")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        spec = rtamt.StlDiscreteTimeSpecification()
        spec.set_sampling_period(STEP_S, "s", 0.1)
        for name in signals:
            spec.declare_var(name, "float")
        spec.spec = text
        spec.parse()
        times = [STEP_S * index for index in range(len(signals["x"]))]
        reference = spec.evaluate({"time": times, **{name: list(values) for name, values in signals.items()}})
    return np.array([value for _, value in reference])


def test_robustness_equals_that_of_rtamt_for_200_random_formulas():
    compared = 0
    for seed in range(200):
        source = random.Random(seed)
        text = formula(source, 1 + seed % 4)
        # Long enough for every window, because the tools treat a window beyond the end of a trace differently.
        samples = horizon_samples(text) + source.randint(2, 20)
        numbers = np.random.default_rng(seed)
        signals = {name: numbers.uniform(-5, 5, samples) for name in "xyz"}
        reference = rtamt_robustness(text, signals)
        found = crumple.monitor(text, signals, step_s=STEP_S, over_time=True)
        whole = samples - horizon_samples(text) + 1
        assert np.array_equal(found[:whole], reference[:whole]), text
        assert crumple.monitor(text, signals, step_s=STEP_S) == reference[0], text
        compared += whole
    assert compared > 2000


def test_a_batch_of_traces_equals_single_traces():
    numbers = np.random.default_rng(1)
    for traces, samples in [(3, 20), (2500, 60)]:
        gap_m, speed_mps = numbers.uniform(0, 10, (2, traces, samples))
        limit_mps = numbers.uniform(0, 10, samples)
        signals = {"gap_m": gap_m, "speed_mps": speed_mps, "limit_mps": limit_mps}
        text = "always[0,10] (gap_m > 2 or eventually[0,3] speed_mps - limit_mps < 0)"
        every = crumple.monitor(text, signals)
        over_time = crumple.monitor(text, signals, over_time=True)
        assert (every.shape, over_time.shape) == ((traces,), (traces, samples))
        assert np.array_equal(over_time[:, 0], every)
        for index in range(0, traces, 100):
            alone = {"gap_m": gap_m[index], "speed_mps": speed_mps[index], "limit_mps": list(limit_mps)}
            assert crumple.monitor(text, alone) == every[index]
    assert crumple.monitor("x > 0", {"x": np.zeros((0, 5))}).shape == (0,)


def test_a_window_is_clipped_at_the_end_of_the_trace():
    assert crumple.monitor("always[0,9] x > 1", {"x": [3.0, 2.0]}) == 1.0
    assert crumple.monitor("always[5,9] x > 1", {"x": [3.0, 2.0]}) == math.inf
    assert crumple.monitor("eventually[5,9] x > 1", {"x": [3.0, 2.0]}) == -math.inf


@pytest.mark.parametrize(
    ("text", "signals", "step_s", "message"),
    [
        ("always", {"x": [1.0]}, 1.0, "column 7"),
        ("y > 0", {"x": [1.0]}, 1.0, "no signal `y`"),
        ("x > 0", {}, 1.0, "one sample"),
        ("x > 0", {"x": []}, 1.0, "one sample"),
        ("x > 0", {"x": [1.0, math.nan]}, 1.0, "not a number"),
        ("x > 0", {"x": [1.0], "y": [1.0, 2.0]}, 1.0, "`y` has 1 rows of 2"),
        ("x > 0", {"x": [[1.0], [2.0]], "y": [[1.0], [2.0], [3.0]]}, 1.0, "`x` has 2 rows"),
        ("x > 0", {"x": [[[1.0]]]}, 1.0, "3 dimensions"),
        ("x > 0", {"x": "fast"}, 1.0, "no array of numbers"),
        ("x > 0", {"x": [1j]}, 1.0, "no array of numbers"),
        ("x > 0", {"x": [[1.0], [1.0, 2.0]]}, 1.0, "no array of numbers"),
        ("x > 0", {"x": 1.0}, 1.0, "0 dimensions"),
        ("x > 0", {"x": [1.0]}, 0.0, "step"),
        ("always[0.4,0.6] x > 0", {"x": [1.0]}, 1.0, "no sample"),
    ],
)
def test_invalid_input_is_explained(text, signals, step_s, message):
    with pytest.raises(crumple.FormulaError, match=message):
        crumple.monitor(text, signals, step_s=step_s)


def test_a_replayed_failure_has_the_recorded_robustness():
    text = "always v1.gap_m > 1.5"
    found = crumple.falsify("match-leader", spec=text, budget=60)
    assert found.failures
    for failure in found.failures:
        assert failure.replay().robustness(text) == failure.facts["robustness"] < 0


def test_robustness_equals_that_of_the_command_line(command_line_json):
    text = "always v1.time_gap_s > 0.3"
    run = crumple.simulate("paper-1", "idm", after_collision="continue")
    printed = command_line_json("simulate", "paper-1", "--controller", "idm", "--spec", text, "--spec", "no collision")
    assert run.robustness(text) == printed["specifications"][0]["robustness"]
    stopped = crumple.simulate("paper-1", "idm")
    assert stopped.robustness("no collision") == printed["specifications"][1]["robustness"]
    with pytest.raises(crumple.FormulaError, match="v9"):
        run.robustness("always v9.gap_m > 0")
    hit = crumple.simulate("paper-1", "baseline")
    assert hit.robustness("no collision") < 0
    with pytest.raises(crumple.FormulaError, match="continue"):
        hit.robustness(text)
