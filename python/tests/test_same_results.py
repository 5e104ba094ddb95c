"""Results that `crumple` and the Python package both offer: they have the same text and the same JSON."""

import json
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
    for name in {"of_method_asked_for", "of_all_methods"} & printed.keys() - data.keys():
        del printed[name]
    assert data == printed


def resume(arguments):
    """Returns the option to print the results in a folder again."""
    return ["--resume"] if "--out" in arguments else []


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
