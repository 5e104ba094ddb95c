"""Results that `crumple` and the Python package both offer: they have the same text and the same JSON."""

import json
import pickle
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


def worst_case():
    found = crumple.worst_case("paper-1", "idm", budget=200)
    return found.facts, str(found)


def worst_case_of_policy():
    found = crumple.worst_case("paper-1", "policy", budget=200)
    return found.facts, str(found)


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
        (worst_case, ("worst-case", "paper-1", "--controller", "idm", "--budget", 200), 0),
        (worst_case_of_policy, ("worst-case", "paper-1", "--controller", "policy", "--budget", 200), 0),
        (rate_without_proof, (*COUNT, "--controller", "match-leader", "--against", "policy", "--runs", 100), 1),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_text_and_json_are_those_of_the_program(run_program, python_folder, result, arguments, status):
    data, text = result()
    assert text == run_program(arguments, "text", status)
    printed = json.loads(run_program([*arguments, *resume(arguments)], "json", status))
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


@pytest.mark.parametrize("options", [{}, {"after_collision": "continue", "dt_s": 0.005}], ids=["stop", "continue"])
@pytest.mark.parametrize("scenario", ["paper-1", "paper-2"])
@pytest.mark.parametrize("controller", ["idm", "baseline", "shield:full-throttle"])
def test_a_run_is_that_of_the_program(run_program, scenario, controller, options):
    run = crumple.simulate(scenario, controller, **options)
    arguments = ["simulate", scenario, "--controller", controller]
    if options:
        arguments += ["--after-collision", "continue", "--dt", 0.005]
    assert str(run) == run_program(arguments, "text")
    assert run.data == json.loads(run_program(arguments, "json"))
    restored = pickle.loads(pickle.dumps(run))
    assert (str(restored), restored.data) == (str(run), run.data)
    assert run.impacts == run.data["impacts"]


@pytest.mark.parametrize("settings", ["", "reacts=1"])
@pytest.mark.parametrize(("scenario", "controller"), [("paper-1", "idm"), ("paper-2", "full-throttle")])
def test_levels_are_those_of_the_program(run_program, scenario, controller, settings):
    run = crumple.simulate(scenario, controller)
    assert run.levels == []
    run = run.with_levels(settings)
    arguments = ["simulate", scenario, "--controller", controller, f"--level={settings}" if settings else "--level"]
    assert str(run) == run_program(arguments, "text")
    printed = json.loads(run_program(arguments, "json"))
    assert run.data == printed
    assert run.levels == printed["levels"] != []
    for level in run.levels:
        assert level["start_mps2"] == level["level_mps2"][0]
        assert level["min_mps2"] == min(level["level_mps2"])
        assert len(level["time_s"]) == len(level["level_mps2"])
    restored = pickle.loads(pickle.dumps(run))
    assert (str(restored), restored.data) == (str(run), run.data)


def test_levels_need_a_trace_and_settings_of_the_class():
    with pytest.raises(crumple.CrumpleError, match="trace=True"):
        crumple.simulate("paper-1", trace=False).with_levels()
    with pytest.raises(crumple.CrumpleError, match="level"):
        crumple.simulate("paper-1").with_levels("level=3")


def test_a_training_is_that_of_the_program(run_program, python_folder):
    trained = crumple.train("fast", 3, "out", episodes=4)
    arguments = ["train", "--seed", 3, "--episodes", 4, "--out", "out"]
    # No policy of four episodes is better than the untrained network.
    assert str(trained) == run_program(arguments, "text", 1)
    assert [trained.result] == json.loads(run_program([*arguments, "--resume"], "json", 1))


def test_a_pool_is_that_of_the_program(run_program, python_folder, tmp_path):
    certificates = []
    for seed in range(2):
        crumple.rate("idm", "high-risk", runs=500, seed=seed, folder=f"seed-{seed}")
        certificates.append(tmp_path / "python" / f"seed-{seed}" / "certificate.json")
    pooled = crumple.rate.pool(certificates)
    assert str(pooled) == run_program(["check", "--pool", *certificates], "text")
    assert pooled.data == json.loads(run_program(["check", "--pool", *certificates], "json"))


ASSESSMENT = """
version = 1
controllers = ["baseline", "idm"]
paper = false
draws = {draws}
everyday_draws = 0
search = {{ spaces = [], budget = 20 }}
rates = {{ runs = 0 }}
[[gates]]
require = "rate-not-above"
controller = "idm"
than = "baseline"
"""


def test_an_assessment_is_that_of_the_program(run_program, python_folder, tmp_path):
    earlier, present = tmp_path / "earlier.toml", tmp_path / "present.toml"
    earlier.write_text(ASSESSMENT.format(draws=20))
    present.write_text(ASSESSMENT.format(draws=40))
    old_page = crumple.write_report(crumple.assess(earlier), "old")
    old = (tmp_path / "python" / old_page).with_name("assessment.json")
    assessment = crumple.assess(present, against=old)
    arguments = ["assess", present, "--against", old, "--out", "report"]
    text = run_program(arguments, "text")
    assert "Compared with the earlier assessment" in text
    assert str(assessment) == str(pickle.loads(pickle.dumps(assessment))) == text
    assert assessment.evidence["summary"] == json.loads(run_program(arguments, "json"))
    crumple.write_report(assessment, "new")
    folders = [tmp_path / "program" / "report", tmp_path / "python" / "new"]
    written = [json.loads((folder / "assessment.json").read_text()) for folder in folders]
    runs = [report["provenance"].pop("run_info") for report in written]
    assert runs[0].keys() == runs[1].keys()
    assert runs[0]["machine"] == runs[1]["machine"]
    # The program states its commit if it is a release build; the package does if `.ci/release` built it.
    commits = {report["identity"].pop("crumple_commit") for report in written}
    assert len(commits - {None}) <= 1
    for report in written:
        del report["provenance"]["evidence"]
    assert written[0] == written[1]
