"""Tests of scenarios, simulations and controllers in Python."""

import json
import math
import signal
import subprocess
import sys
import textwrap
import threading
from pathlib import Path

import numpy as np
import pytest

import crumple


def follow(observation):
    """Returns the acceleration of a simple follower."""
    if observation.gap_ahead_m is None:
        return 0.0
    speed_mps = observation.speed_mps
    return 0.2 * (observation.gap_ahead_m - 2.0 - 0.8 * speed_mps) + 0.8 * (observation.speed_ahead_mps - speed_mps)


def follow_all(rows):
    """Returns the accelerations of `follow` for a batch."""
    gap_m, ahead_mps, own_mps = rows[:, 0], rows[:, 2], rows[:, 3]
    return 0.2 * (gap_m - 2.0 - 0.8 * own_mps) + 0.8 * (ahead_mps - own_mps)


@pytest.mark.parametrize("estimator", ["kalman", "truth"])
@pytest.mark.parametrize("controller", ["baseline", "policy", "acc-aeb,ttc_s=2.0"])
def test_results_are_bit_identical_to_the_command_line(tmp_path, crumple_binary, controller, estimator):
    scenarios = [crumple.space("high-risk").draw(7, index) for index in range(3)]
    for index, scenario in enumerate(scenarios):
        (tmp_path / f"{index}.toml").write_text(scenario.to_toml())
    arguments = ["simulate", *(str(tmp_path / f"{index}.toml") for index in range(3)), "--controller", controller]
    arguments += ["--estimator", estimator, "--format", "json", "--trace", str(tmp_path / "trace.csv")]
    printed = subprocess.run([crumple_binary, *arguments], check=True, capture_output=True, text=True).stdout
    *lines, total = (json.loads(line) for line in printed.splitlines())
    assert total["total"]["scenarios"] == len(scenarios)
    done = crumple.simulate(scenarios, controller, estimator)
    for expected, one in zip(lines, done, strict=True):
        assert expected["vehicles"] == one.vehicles
        assert expected["impacts"] == one.impacts
        assert expected["outcome"]["kind"] == one.outcome
        written = np.genfromtxt(tmp_path / f"trace-{one.scenario.name}.csv", delimiter=",", names=True)
        for index, track in enumerate(one.trace.vehicles):
            rows = written[written["vehicle"] == index]
            assert np.array_equal(rows["time_s"], one.trace.time_s)
            for name in ("position_m", "speed_mps", "acceleration_mps2"):
                assert np.array_equal(rows[name], getattr(track, name))


def test_traces_are_arrays_that_outlive_their_simulation():
    trace = crumple.simulate("paper-1").trace
    speed_mps = trace.vehicles[2].speed_mps
    assert speed_mps.dtype == np.float64
    assert speed_mps.shape == trace.time_s.shape
    assert speed_mps is trace.vehicles[2].speed_mps, "no copy is made"
    assert crumple.simulate("paper-1", trace=False).trace is None


def test_all_sources_give_the_same_scenario(tmp_path):
    one = crumple.scenario("paper-1")
    path = tmp_path / "one.toml"
    path.write_text(one.to_toml())
    assert one == crumple.scenario(path) == crumple.scenario(str(path))
    assert one == crumple.scenario(one.to_toml()) == crumple.scenario(one.to_dict())
    assert one != one.with_seed(7)
    assert len(one) == 3


def test_errors_have_file_line_and_field(tmp_path):
    text = crumple.scenario("paper-1").to_toml()
    path = tmp_path / "bad.toml"
    path.write_text(text.replace("duration_s = 15.0", "duration_s = -1.0"))
    with pytest.raises(crumple.ScenarioError) as caught:
        crumple.scenario(path)
    error = caught.value
    line = 1 + path.read_text().splitlines().index("duration_s = -1.0")
    assert (error.file, error.line, error.field) == (str(path), line, "duration_s")
    assert str(error).startswith(f"{path}:{line}: duration_s: ")
    assert isinstance(error, crumple.CrumpleError)
    bad = crumple.scenario("paper-1").to_dict()
    bad["vehicles"][1]["speed_mps"] = -3.0
    with pytest.raises(crumple.ScenarioError) as caught:
        crumple.scenario(bad)
    assert (caught.value.file, caught.value.field) == ("<dict>", "vehicles[1].speed_mps")


@pytest.mark.parametrize(
    ("wrong", "error"),
    [
        (lambda: crumple.scenario("no-such"), crumple.ScenarioError),
        (lambda: crumple.scenario({"duration_s": math.nan}), crumple.ScenarioError),
        (lambda: crumple.scenario("version = 1\nnonsense"), crumple.ScenarioError),
        (lambda: crumple.space("no-such"), crumple.SpaceError),
        (lambda: crumple.simulate("paper-1", "no-such"), crumple.ControllerError),
        (lambda: crumple.simulate("paper-1", 3), crumple.ControllerError),
        (lambda: crumple.simulate("paper-1", dt_s=0.003), crumple.RunError),
        (lambda: crumple.simulate("paper-1", crumple.Controller(follow, interval_s=0.013)), crumple.RunError),
        (lambda: crumple.simulate("paper-1", crumple.Controller(follow, interval_s=-1.0)), ValueError),
        (lambda: crumple.simulate("paper-1", estimator="eyes"), ValueError),
        (lambda: crumple.falsify("baseline", method="luck"), crumple.CampaignError),
        (lambda: crumple.falsify("baseline", spec="always"), crumple.CampaignError),
    ],
)
def test_other_errors_have_specific_exceptions(wrong, error):
    with pytest.raises(error):
        wrong()


def test_all_kinds_of_callables_drive_alike():
    scenarios = [crumple.space("high-risk").draw(1, index) for index in range(40)]
    alone = crumple.simulate(scenarios, follow, trace=False)
    seen_rows = []

    def recording(rows):
        assert rows.shape[1] == len(crumple.OBSERVATION)
        seen_rows.append(len(rows))
        return follow_all(rows)

    batch = crumple.simulate(scenarios, crumple.Controller(recording, batch=True), trace=False)
    each = crumple.simulate(scenarios, crumple.Controller(lambda vehicle, seed: follow, each_run=True), trace=False)
    for one, other, third in zip(alone, batch, each, strict=True):
        assert one.vehicles == other.vehicles == third.vehicles
        assert one.impacts == other.impacts == third.impacts
    assert max(seen_rows) >= 10, "runs share a call"


def test_an_exception_ends_its_run_and_has_a_traceback():
    space = crumple.space("high-risk")
    scenarios = [space.draw(1, index) for index in range(20)]
    fastest = max(scenario.to_dict()["vehicles"][1]["speed_mps"] for scenario in scenarios)

    def refuse(rows):
        if (rows[:, 3] >= fastest).any():
            raise RuntimeError("too fast for me")
        return follow_all(rows)

    done = crumple.simulate(scenarios, crumple.Controller(refuse, batch=True), "truth")
    failed = [one for one in done if one.outcome == "controller_failed"]
    others = crumple.simulate(scenarios, follow, "truth")
    assert len(failed) == 1
    assert "too fast for me" in failed[0].failure
    assert "in refuse" in failed[0].failure
    for one, other in zip(done, others, strict=True):
        assert one in failed or one.vehicles == other.vehicles


@pytest.mark.parametrize("answer", [math.nan, "fast", None, [1.0, 2.0]])
def test_an_invalid_answer_is_a_failure(answer):
    for batch in (False, True):
        done = crumple.simulate("paper-1", crumple.Controller(lambda observation: answer, batch=batch))
        assert done.outcome == "controller_failed"


def test_a_controller_that_simulates_fails_without_a_deadlock():
    done = crumple.simulate(["paper-1", "paper-2"], lambda observation: len(crumple.simulate(["paper-1"])))
    assert all("a controller cannot begin simulations" in one.failure for one in done)


def test_progress_is_reported_and_can_end_the_work():
    scenarios = [crumple.space("paper").draw(0, index) for index in range(1500)]
    states = []
    crumple.simulate(scenarios, trace=False, progress=lambda *state: states.append(state))
    assert states[-1][:2] == (1500, 1500)

    def stop_early(done, total, failures):
        raise KeyError("enough")

    with pytest.raises(KeyError):
        crumple.simulate(scenarios, trace=False, progress=stop_early)


def test_ctrl_c_stops_long_work():
    script = textwrap.dedent("""
        import crumple
        print("started", flush=True)
        try:
            crumple.falsify("idm", "steady", budget=100_000_000)
        except KeyboardInterrupt:
            print("stopped")
    """)
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "started\n"
        threading.Timer(1.0, process.send_signal, [signal.SIGINT]).start()
        output, _ = process.communicate(timeout=60)
    assert (output, process.returncode) == ("stopped\n", 0)


def test_other_threads_run_during_work():
    ticks = []
    over = threading.Event()

    def tick():
        while not over.wait(0.001):
            ticks.append(1)

    thread = threading.Thread(target=tick)
    thread.start()
    crumple.simulate([crumple.space("paper").draw(0, index) for index in range(300)], "policy", trace=False)
    before = len(ticks)
    crumple.simulate([crumple.space("paper").draw(0, index) for index in range(300)], "policy", trace=False)
    over.set()
    thread.join()
    assert len(ticks) > before, "the interpreter's lock was held"


def test_falsify_equals_the_command_line(tmp_path, command_line_json):
    found = crumple.falsify("match-leader", budget=100, seed=3)
    arguments = ["falsify", "--controller", "match-leader", "--budget", "100", "--seed", "3"]
    printed = command_line_json(*arguments, "--out", tmp_path / "campaign")
    assert printed == found.summary
    assert found.falsified


def test_a_batch_campaign_replays_failures_and_resumes(tmp_path):
    mine = crumple.Controller(follow_all, batch=True, interval_s=0.1, name="mine", identity="follow, version 1")
    found = crumple.falsify(mine, budget=60, folder=tmp_path / "campaign")
    assert found.failures
    for failure in found.failures:
        again = failure.replay()
        assert again.collision is not None
        assert again.collision["impact_speed_mps"] == failure.facts["impact_speed_mps"]
    resumed = crumple.falsify(mine, budget=60, folder=tmp_path / "campaign", resume=True)
    assert resumed.summary == found.summary
    alone = crumple.Controller(follow, interval_s=0.1)
    assert crumple.falsify(alone, budget=60).summary["counterexamples"] == found.summary["counterexamples"]
    with pytest.raises(crumple.CampaignError, match="identity"):
        crumple.falsify(alone, budget=60, folder=tmp_path / "other", resume=True)


def test_an_interrupted_campaign_resumes_to_the_same_result(tmp_path):
    whole = crumple.falsify("match-leader", budget=200, folder=tmp_path / "whole")
    counts = []

    def stop_early(done, total, failures):
        counts.append(done)
        if done >= 100:
            raise KeyError("enough")

    with pytest.raises(KeyError):
        crumple.falsify("match-leader", budget=200, folder=tmp_path / "parts", progress=stop_early)
    assert max(counts) < 600
    assert crumple.falsify("match-leader", budget=200, folder=tmp_path / "parts", resume=True).summary == whole.summary


def test_a_scenario_starts_no_program_without_permission(tmp_path):
    (tmp_path / "evil.sh").write_text(": > started\n")
    (tmp_path / "evil.toml").write_text('version = 1\ncommand = ["sh", "evil.sh"]\nfiles = ["evil.sh"]\n')
    scenario = tmp_path / "driven.toml"
    text = crumple.scenario("paper-1").to_toml()
    assert '"baseline"' in text
    scenario.write_text(text.replace('"baseline"', '{ file = { path = "evil.toml" } }'))
    with pytest.raises(crumple.ScenarioError, match="allow_external") as caught:
        crumple.simulate(scenario)
    assert caught.value.field == "vehicles[2].driver.file.path"
    assert not (tmp_path / "started").exists()


def test_names_of_earlier_releases_work_and_warn(tmp_path):
    with pytest.warns(FutureWarning, match="after_collision"):
        run = crumple.simulate("paper-1", "idm", after_contact="continue")
    assert run.outcome == crumple.simulate("paper-1", "idm", after_collision="continue").outcome
    with pytest.warns(FutureWarning, match="`collision`"):
        assert run.contact == run.collision
    old_space = Path(__file__).parents[2] / "corpora/versions/0.3.0/space.toml"
    with pytest.warns(FutureWarning, match="braking_clusters"):
        crumple.Space.find(str(old_space))
