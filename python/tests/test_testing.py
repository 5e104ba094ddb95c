"""Tests of property tests with Hypothesis, of pickled values, and of controllers as processes."""

import copy
import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import Phase, given, seed, settings
from test_simulate import follow, follow_all

import crumple
from crumple import testing


def sound(seen):
    """Returns the acceleration of the Intelligent Driver Model."""
    free = 1.0 - (seen.speed_mps / 33.0) ** 4
    if seen.gap_ahead_m is None:
        return free
    closing_mps = seen.speed_mps - seen.speed_ahead_mps
    wanted_m = 2.0 + max(1.2 * seen.speed_mps + seen.speed_mps * closing_mps / 2.4, 0.0)
    return float(np.clip(free - (wanted_m / max(seen.gap_ahead_m, 0.1)) ** 2, -9.0, 1.5))


def no_brakes_beyond_30_mps(seen):
    return 0.0 if seen.speed_mps > 30.0 else sound(seen)


def violation(controller, strategy, *properties, folder, phases=(Phase.generate,)):
    """Runs a test of Hypothesis and returns its failure."""

    @seed(0)
    @settings(max_examples=100, deadline=None, database=None, phases=phases)
    @given(strategy)
    def run(scenario):
        testing.check(controller, scenario, *properties, corpus=folder)

    try:
        run()
    except testing.PropertyViolated as violated:
        return violated
    return None


def test_a_planted_defect_is_found_and_its_scenario_is_simple(tmp_path):
    not_worse = testing.Property.not_worse_than(sound)
    strategy = testing.scenarios("high-risk")
    assert violation(sound, strategy, not_worse, folder=tmp_path) is None
    found = str(violation(no_brakes_beyond_30_mps, strategy, not_worse, folder=tmp_path, phases=Phase))
    assert "the reference avoids it" in found
    (file,) = tmp_path.glob("*.toml")
    assert str(file) in found
    scenario = crumple.scenario(file)
    with pytest.raises(testing.PropertyViolated):
        testing.check(no_brakes_beyond_30_mps, scenario, not_worse, corpus=tmp_path)
    # The only parameter that differs from nominal is the speed of all vehicles.
    changed, nominal = scenario.to_dict(), crumple.space("high-risk").nominal().to_dict()
    speeds = {one.pop("speed_mps") for one in changed["vehicles"]}
    assert len(speeds) == 1
    assert 30.0 < speeds.pop() < 31.0
    for one in nominal["vehicles"]:
        del one["speed_mps"]
    assert changed == nominal


@pytest.mark.parametrize(
    ("strategy", "tested", "controller"),
    [
        (testing.any_scenario(), testing.Property.deterministic(), lambda _seen: float("nan")),
        (testing.any_scenario(), testing.Property.no_avoidable_collision(), lambda _seen: 0.0),
        (testing.line_of_five(), testing.Property.no_amplification(), lambda seen: 0.05 * (seen.gap_ahead_m - 30.0)),
        (testing.near("paper-1"), testing.Property.bounded_jerk(5.0), "baseline"),
        (testing.near("paper-1"), testing.Property.specification("always v1.speed_mps < 5"), sound),
        (testing.scenarios("traffic"), testing.Property.no_unnecessary_braking(), lambda _seen: -6.0),
        (
            testing.scenarios("alone"),
            testing.Property.metamorphic("larger-gap=5"),
            lambda seen: 0.0 if (seen.gap_ahead_m or 0.0) > 30.0 else max(sound(seen), -4.0),
        ),
    ],
)
def test_every_property_finds_a_violation(tmp_path, strategy, tested, controller):
    assert f"property violated: {tested.name}" in str(violation(controller, strategy, tested, folder=tmp_path))


def test_an_exception_of_the_controller_is_in_the_message(tmp_path):
    def faulty(_seen):
        raise ValueError("a table ends here")

    assert "a table ends here" in str(violation(faulty, testing.any_scenario(), folder=tmp_path))
    with pytest.raises(crumple.errors.FormulaError, match="column"):
        testing.Property.specification("always v1.speed_mps >")


def test_an_error_is_a_violation_and_an_unsuitable_scenario_none(tmp_path):
    scenario = crumple.scenario("paper-1")
    missing = testing.Property.specification("always v5.speed_mps >= 0")
    assert testing.check(sound, scenario, testing.Property.deterministic(), corpus=tmp_path)
    assert not testing.check(sound, scenario, missing, corpus=tmp_path)
    # The scenario's step does not divide the interval, also after a change to a suitable step.
    odd = crumple.Controller(sound, interval_s=1e-9)
    with pytest.raises(testing.PropertyViolated, match="the property ends with an error: the controller decides every"):
        testing.check(odd, scenario, corpus=tmp_path)
    # A violation of one property counts, even if the scenario does not test another one.
    slow = testing.Property.specification("always v1.speed_mps < 1")
    with pytest.raises(testing.PropertyViolated, match="speed_mps < 1"):
        testing.check(sound, scenario, missing, slow, corpus=tmp_path)


SAME_NAME = """
import crumple
from crumple import testing


def test_it():
    testing.check(lambda seen: {acceleration}, crumple.scenario("{scenario}"), corpus="corpus")
"""


def test_tests_of_one_name_in_two_files_have_separate_files(tmp_path):
    for name, scenario in (("test_one.py", "paper-1"), ("test_two.py", "paper-3"), ("a/test_one.py", "paper-2")):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(SAME_NAME.format(acceleration=0.0, scenario=scenario))
    arguments = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--import-mode=importlib", "."]
    environment = {name: value for name, value in os.environ.items() if name != "PYTEST_CURRENT_TEST"}
    ran = subprocess.run(arguments, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert "3 failed" in ran.stdout, ran.stdout
    files = sorted((tmp_path / "corpus").iterdir())
    assert [file.name[:16] for file in files] == ["test_one-test_it", "test_one-test_it", "test_two-test_it"]
    assert all(file.suffix == ".toml" for file in files), "no temporary file remains"
    assert {crumple.scenario(file).name for file in files} == {"paper-1", "paper-2", "paper-3"}


def test_scenarios_and_spaces_can_be_pickled():
    for name in ("high-risk", "traffic", "alone"):
        space = crumple.space(name)
        for same in (pickle.loads(pickle.dumps(space)), copy.deepcopy(space)):
            assert same.to_dict() == space.to_dict()
            assert [same.draw(3, index) for index in range(5)] == [space.draw(3, index) for index in range(5)]
        scenario = space.draw(3, 7)
        assert pickle.loads(pickle.dumps(scenario)) == copy.copy(scenario) == scenario


@pytest.mark.parametrize(
    "controller", ["follow", "crumple.Controller(follow_all, batch=True)", "crumple.Controller(Ramp, each_run=True)"]
)
def test_a_served_controller_drives_like_one_in_this_process(tmp_path, controller):
    program = tmp_path / "mine.py"
    program.write_text(
        f"import sys\nsys.path.insert(0, {str(Path(__file__).parent)!r})\n"
        "import crumple\nfrom test_simulate import follow, follow_all\nfrom test_testing import Ramp\n"
        f"crumple.serve({controller})\n"
    )
    own = eval(controller, {"crumple": crumple, "follow": follow, "follow_all": follow_all, "Ramp": Ramp})
    scenarios = [crumple.scenario("paper-1"), crumple.space("traffic").draw(0, 0)]
    served = crumple.simulate(scenarios, f"exec:{sys.executable} {program}", "truth")
    for one, other in zip(crumple.simulate(scenarios, own, "truth"), served, strict=True):
        assert one.failure is None
        assert other.failure is None
        # A process observes the relative speed instead of the leader's.
        for track, same in zip(one.trace.vehicles, other.trace.vehicles, strict=True):
            assert np.allclose(track.position_m, same.position_m, rtol=0, atol=1e-6)


class Ramp:
    """Controller with memory, which brakes harder at every decision and prints."""

    def __init__(self, vehicle, seed):
        print("drives", vehicle)
        self.command_mps2 = -0.001 * vehicle - 1e-22 * seed

    def __call__(self, _seen):
        self.command_mps2 -= 0.001
        return self.command_mps2
