"""Results that `crumple` and the Python package both offer: they have the same text and the same JSON."""

import json
import random
import subprocess

import pytest

import crumple


@pytest.fixture
def run_program(crumple_binary, tmp_path):
    """Returns a function that runs the program in a folder of its own, and returns its standard output."""
    folder = tmp_path / "program"
    folder.mkdir()

    def run(arguments, output_format, status=0):
        words = [crumple_binary, *map(str, arguments), "--format", output_format, "--quiet"]
        done = subprocess.run(words, check=False, capture_output=True, text=True, cwd=folder)
        assert done.returncode == status, done.stderr
        return done.stdout

    return run


@pytest.fixture
def python_folder(tmp_path, monkeypatch):
    """Changes to a folder for results of the Python package: the same relative paths as for the program."""
    folder = tmp_path / "python"
    folder.mkdir()
    monkeypatch.chdir(folder)


def falsify():
    found = crumple.falsify("match-leader", budget=100, seed=3, folder="text")
    return found.summary, str(found)


def compare():
    compared = crumple.compare("match-leader", methods=["uniform", "cma-es"], seeds=3, budget=50)
    return compared.data, str(compared)


def rate():
    counted = crumple.rate("idm", "high-risk", runs=700, confidence=0.9, folder="text")
    return counted.data, str(counted)


def rate_of_two():
    counted = crumple.rate("policy", "high-risk", against="match-leader", runs=300, folder="text")
    return counted.data, str(counted)


def rate_without_proof():
    counted = crumple.rate("match-leader", "high-risk", against="policy", runs=100, folder="text")
    assert counted.words == counted.words.strip() != ""
    return counted.data, str(counted)


COUNT = ("verify", "rate", "--space", "high-risk", "--out", "text")


@pytest.mark.parametrize(
    ("result", "arguments", "status"),
    [
        (falsify, ("falsify", "--controller", "match-leader", "--budget", 100, "--seed", 3, "--out", "text"), 0),
        (
            compare,
            ("falsify", "--controller", "match-leader", "--compare", "uniform,cma-es", "--seeds", 3, "--budget", 50),
            0,
        ),
        (rate, (*COUNT, "--controller", "idm", "--runs", 700, "--confidence", 0.9), 0),
        (rate_of_two, (*COUNT, "--controller", "policy", "--against", "match-leader", "--runs", 300), 0),
        (rate_without_proof, (*COUNT, "--controller", "match-leader", "--against", "policy", "--runs", 100), 1),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_text_and_json_are_those_of_the_program(run_program, python_folder, result, arguments, status):
    data, text = result()
    assert text == run_program(arguments, "text", status)
    printed = json.loads(run_program([*arguments, *resume(arguments)], "json", status))
    # The program adds totals of several methods to the summary of a campaign.
    for name in {"requested_method", "all_methods"} & printed.keys() - data.keys():
        del printed[name]
    assert data == printed


def resume(arguments):
    """Returns the option to print the results in a folder again."""
    return ["--resume"] if "--out" in arguments else []


def write_recording(path):
    """Writes 40 episodes in which a leader brakes from 12 to 18 m/s with 2 to 5 m/s²."""
    random.seed(0)
    rows = ["event,time_s,gap_m,follower_speed_mps,relative_speed_mps,leader_speed_mps"]
    for event in range(40):
        leader_mps = random.uniform(12.0, 18.0)
        follower_mps = leader_mps + random.uniform(-1.0, 1.0)
        gap_m = follower_mps * random.uniform(1.0, 2.0)
        brake_mps2 = random.uniform(2.0, 5.0)
        last_mps = leader_mps * random.uniform(0.2, 0.6)
        for step in range(80):
            time_s = 0.1 * step
            speeds = f"{follower_mps:.3f},{leader_mps - follower_mps:.3f},{leader_mps:.3f}"
            rows.append(f"{event},{time_s:.1f},{gap_m:.3f},{speeds}")
            gap_m += 0.1 * (leader_mps - follower_mps)
            if time_s >= 2.0:
                leader_mps = max(last_mps, leader_mps - 0.1 * brake_mps2)
            follower_mps += 0.1 * max(-5.0, min(1.0, 0.2 * (gap_m - 2.0 - 1.2 * follower_mps)))
    path.write_text("\n".join(rows) + "\n")


def test_rates_per_hour_are_those_of_the_program(run_program, python_folder, tmp_path):
    write_recording(tmp_path / "events.csv")
    run_program(["fit", tmp_path / "events.csv", "--out", tmp_path / "fitted.toml", "--samples", 19], "text")
    space = tmp_path / "fitted.toml"
    counted = crumple.rate("idm", space, runs=500, confidence=0.9, resamples=0, folder="text")
    arguments = ["verify", "rate", "--controller", "idm", "--space", space, "--runs", 500, "--confidence", 0.9]
    arguments += ["--resamples", 0, "--out", "text"]
    assert str(counted) == run_program(arguments, "text")
    assert "failures per hour" in str(counted)
    assert counted.data == json.loads(run_program([*arguments, "--resume"], "json"))
    with pytest.raises(crumple.RateError, match="resamples: must be 0 or at least 79"):
        crumple.rate("idm", space, runs=500, resamples=5)


@pytest.mark.parametrize("scenario", ["paper-1", "paper-2"])
@pytest.mark.parametrize("controller", ["idm", "baseline"])
def test_a_run_is_that_of_the_program(run_program, scenario, controller):
    printed = json.loads(run_program(["simulate", scenario, "--controller", controller], "json"))
    run = crumple.simulate(scenario, controller)
    assert run.scenario.name == printed["scenario"]
    assert run.controller == printed["controller"]
    assert run.outcome == printed["outcome"]["kind"]
    assert run.vehicles == printed["vehicles"]
    assert run.impacts == printed["impacts"]


@pytest.mark.parametrize("controller", ["idm", "policy"])
def test_a_worst_case_is_that_of_the_program(run_program, controller):
    printed = json.loads(run_program(["worst-case", "paper-1", "--controller", controller, "--budget", 200], "json"))
    facts = crumple.worst_case("paper-1", controller, budget=200).facts
    # The program adds fields about --budget.
    assert facts == {name: printed[name] for name in facts}
