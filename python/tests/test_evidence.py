"""Tests of failure rates, worst cases and assessments."""

import json
import signal
import subprocess
import sys
import textwrap
import threading
from pathlib import Path

import pytest

import crumple


def follow_all(rows):
    gap_m, ahead_mps, own_mps = rows[:, 0], rows[:, 2], rows[:, 3]
    return 0.2 * (gap_m - 2.0 - 0.8 * own_mps) + 0.8 * (ahead_mps - own_mps)


def follower(identity="follow, version 1"):
    return crumple.Controller(follow_all, batch=True, interval_s=0.1, name="mine", identity=identity)


class StopEarlyError(Exception):
    """Exception of a callback that ends the work."""


def stop_after_share(share):
    def progress(done, total, failures):
        if done >= share * total:
            raise StopEarlyError

    return progress


def certificate_by_command_line(crumple_binary, folder, *arguments):
    """Returns the certificate of the program."""
    arguments = [crumple_binary, "verify", "rate", *map(str, arguments), "--out", folder, "--quiet"]
    subprocess.run(arguments, check=True, capture_output=True)
    return json.loads((folder / "certificate.json").read_text())


def test_a_certified_rate_equals_that_of_the_command_line(tmp_path, crumple_binary):
    one = crumple.rate("idm", "high-risk", runs=700, seed=3, confidence=0.9)
    arguments = ("--space", "high-risk", "--runs", 700, "--seed", 3, "--confidence", 0.9)
    assert one.certificate == certificate_by_command_line(
        crumple_binary, tmp_path / "one", "--controller", "idm", *arguments
    )
    assert (one.runs, one.failures) == (700, one.certificate["statement"]["rate"]["failures"])
    assert one.failures / 700 < one.rate_at_most < 1
    two = crumple.rate("policy", "high-risk", against="match-leader", runs=300)
    arguments = ("--controller", "policy", "--against", "match-leader", "--space", "high-risk", "--runs", 300)
    assert two.certificate == certificate_by_command_line(crumple_binary, tmp_path / "two", *arguments)
    assert two.rate_at_most is None
    nothing = crumple.rate("match-leader", "high-risk", against="policy", runs=100)
    assert nothing.certificate is None
    assert nothing.words


def test_failures_of_a_callable_are_counted_if_it_has_an_identity(tmp_path):
    states = []
    whole = crumple.rate(follower(), "high-risk", runs=3000, progress=lambda *state: states.append(state))
    assert states[-1] == (3000, 3000, whole.failures)
    assert whole.failures > 0
    with pytest.raises(crumple.RateError, match="identity"):
        crumple.rate(follower(None), runs=100)
    with pytest.raises(crumple.RateError, match="runs"):
        crumple.rate("idm", runs=0)
    folder = tmp_path / "rate"
    with pytest.raises(StopEarlyError):
        crumple.rate(follower(), "high-risk", runs=3000, folder=folder, progress=stop_after_share(0.3))
    again = crumple.rate(follower(), "high-risk", runs=3000, folder=folder, resume=True)
    assert again == whole


def test_an_interrupted_campaign_resumes_without_false_failures(tmp_path):
    whole = crumple.falsify(follower(), budget=100, folder=tmp_path / "whole")
    for share in (0.05, 0.9):
        folder = tmp_path / str(share)
        with pytest.raises(StopEarlyError):
            crumple.falsify(follower(), budget=100, folder=folder, progress=stop_after_share(share))
        assert crumple.falsify(follower(), budget=100, folder=folder, resume=True).summary == whole.summary


@pytest.mark.parametrize(
    ("controller", "aim"), [("baseline", "mildest"), ("idm", "severest"), ("policy", "least-peak")]
)
def test_a_worst_case_equals_that_of_the_command_line(tmp_path, command_line_json, command_line_text, controller, aim):
    found = crumple.worst_case("paper-1", controller, aim=aim, budget=200)
    arguments = ("worst-case", "paper-1", "--controller", controller, "--aim", aim, "--budget", 200)
    printed = command_line_json(*arguments, "--out", tmp_path / "worst.toml")
    assert printed == found.facts
    assert str(found) == command_line_text(*arguments)
    assert found.found == (tmp_path / "worst.toml").exists()
    if found.scenario is not None:
        assert found.scenario == crumple.scenario(tmp_path / "worst.toml")
        assert found.replay().outcome == found.facts["outcome"]["kind"]


def test_a_callable_has_a_worst_case():
    counts = []
    found = crumple.worst_case("paper-1", follower(None), budget=400, progress=lambda *state: counts.append(state[0]))
    assert found.found
    assert found.replay().collision["impact_speed_mps"] == found.facts["outcome"]["impact_speed_mps"]
    assert counts == sorted(counts)
    assert "</svg>" in found.plot().svg
    with pytest.raises(StopEarlyError):
        crumple.worst_case("paper-1", follower(), budget=400, progress=stop_after_share(0.1))
    with pytest.raises(crumple.RunError, match="no braking"):
        crumple.worst_case("paper-1", max_brake_mps2=0.0)
    with pytest.raises(ValueError, match="aim"):
        crumple.worst_case("paper-1", aim="luck")
    with pytest.raises(crumple.RunError, match="budget: must be a whole number from 1 to 10000000, found 0"):
        crumple.worst_case("paper-1", budget=0)
    safe = crumple.worst_case("paper-1", "idm", max_brake_mps2=0.01, budget=20)
    with pytest.raises(ValueError, match="nothing to replay"):
        safe.replay()


SMALL = {
    "version": 1,
    "controllers": ["baseline", "idm"],
    "paper": False,
    "draws": 10,
    "everyday_draws": 0,
    "search": {"spaces": ["high-risk"], "budget": 10},
    "rates": {"runs": 0},
}


def write_small_config(folder):
    path = folder / "small.toml"
    path.write_text(
        'version = 1\ncontrollers = ["baseline", "idm"]\npaper = false\ndraws = 20\neveryday_draws = 0\n'
        'search = { spaces = ["high-risk"], budget = 20 }\nrates = { runs = 0 }\n'
        '[[gates]]\nrequire = "rate-not-above"\ncontroller = "idm"\nthan = "baseline"\n'
    )
    return path


def test_an_assessment_equals_that_of_the_command_line(tmp_path, crumple_binary):
    path = write_small_config(tmp_path)
    assessment = crumple.assess(path)
    folder = tmp_path / "report"
    done = subprocess.run(
        [crumple_binary, "assess", path, "--out", folder, "--quiet"], capture_output=True, check=False
    )
    written = json.loads((folder / "assessment.json").read_text())
    assert written["provenance"].pop("run_info") is not None
    evidence = assessment.evidence
    assert evidence["provenance"].pop("run_info") is not None
    # The program states its commit if it is a release build; the package does if `.ci/release` built it.
    commits = {report["identity"].pop("crumple_commit") for report in (written, evidence)}
    assert len(commits - {None}) <= 1
    # Without a cache folder there are no hashes of cached evidence.
    assert evidence == written
    assert crumple.assess(path.read_text()).evidence["summary"] == written["summary"]
    assert (done.returncode == 0) == assessment.passed == all(gate["holds"] for gate in assessment.gates)
    page = crumple.write_report(assessment, tmp_path / "mine")
    names = {str(file.relative_to(tmp_path / "mine")) for file in (tmp_path / "mine").rglob("*") if file.is_file()}
    assert names == {*assessment.files(), "report.sha256"}
    assert page.read_text() == assessment.html()
    # The same call repairs an incomplete report, and replaces no file that a person changed.
    (tmp_path / "mine" / "work.json").unlink()
    assert crumple.write_report(assessment, tmp_path / "mine") == page
    assert (tmp_path / "mine" / "work.json").read_bytes() == assessment.files()["work.json"]
    page.write_text("mine")
    with pytest.raises(crumple.AssessmentError, match=r"assessment\.html: has changed, or crumple did not write it"):
        crumple.write_report(assessment, tmp_path / "mine")
    assert page.read_text() == "mine"
    (tmp_path / "file").write_text("mine")
    with pytest.raises(crumple.AssessmentError, match="file: is not a folder"):
        crumple.write_report(assessment, tmp_path / "file")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="limits the size of files as Linux does")
def test_a_report_on_a_full_disk_changes_no_file(tmp_path):
    script = """
import pathlib, resource, signal, sys
import crumple
from test_evidence import SMALL

assessment = crumple.assess(SMALL)
crumple.write_report(assessment, sys.argv[1])
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (5000, resource.RLIM_INFINITY))
try:
    crumple.write_report(assessment, sys.argv[2])
except crumple.AssessmentError as error:
    print(error)
resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
print([path for path in pathlib.Path(sys.argv[2]).rglob("*") if path.is_file()])
crumple.write_report(assessment, sys.argv[2])
"""
    folders = [tmp_path / "whole", tmp_path / "full"]
    arguments = [sys.executable, "-c", script, *map(str, folders)]
    done = subprocess.run(arguments, check=True, capture_output=True, text=True, cwd=Path(__file__).parent)
    error, left = done.stdout.splitlines()
    assert "File too large" in error or "file too large" in error
    assert left == "[]"
    files = [{file.relative_to(folder) for file in folder.rglob("*")} for folder in folders]
    assert files[0] == files[1]


def without_run_info(assessment):
    evidence = assessment.evidence
    assert evidence["provenance"].pop("run_info") is not None
    return evidence


def test_the_driver_of_a_suite_brakes_after_the_warning_of_a_callable(tmp_path):
    suite = tmp_path / "own.toml"
    parameters = {"own_speed": 20.0, "closing_time": 8.0, "manual_deceleration": 6.0, "manual_delay": 0.5}
    units = {"own_speed": "m/s", "manual_deceleration": "m/s2"}
    suite.write_text(
        'version = 1\nname = "own"\nabout = "A"\ndocument = "D"\nedition = "E"\nparameter_source = "S"\n'
        '[[clauses]]\nclause = "1"\nsummary = "S"\n[[clauses.tests]]\nname = "stands"\nlead = "stopped"\n'
        + "".join(
            f'parameters.{name} = {{ values = [{value}], unit = "{units.get(name, "s")}", origin = "chosen" }}\n'
            for name, value in (parameters | {"warning_closing_time": 0.1}).items()
        )
    )
    config = SMALL | {"suites": [{"suite": str(suite)}], "search": {"spaces": []}}
    outcomes = {}
    for name, warns_at_m in [("early", 100.0), ("late", 10.0)]:
        warner = crumple.Controller(
            lambda seen, at_m=warns_at_m: (0.0, seen.gap_ahead_m < at_m), name=name, identity=name, warns=True
        )
        tests = crumple.assess(config, [warner]).evidence["suites"]["suites"][0]["tests"]
        outcomes[name] = tests[0]["outcomes"][-1]
    assert [outcome["passed"] for outcome in outcomes.values()] == [True, False]
    assert {outcome["warning"] for outcome in outcomes.values()} == {"warning: reported by the controller"}


def test_a_callable_is_assessed_and_displayed(tmp_path):
    states = []
    cache = tmp_path / "evidence"
    one = crumple.assess(SMALL, [follower()], evidence=cache, progress=lambda *state: states.append(state))
    assert one.evidence["provenance"]["config"]["subject"] == "mine"
    assert states
    shown = one._repr_html_()
    assert shown.startswith("<iframe srcdoc=")
    assert '"' not in shown.removeprefix('<iframe srcdoc="').split('" sandbox')[0]
    assert "mine" in str(one)
    calls = []

    def counting_controller(rows):
        calls.append(len(rows))
        return follow_all(rows)

    again = crumple.Controller(
        counting_controller, batch=True, interval_s=0.1, name="mine", identity="follow, version 1"
    )
    assert without_run_info(crumple.assess(SMALL, [again], evidence=cache)) == without_run_info(one)
    assert crumple.assess(SMALL, [follower(None)]).evidence["summary"]["gates"] == []
    with pytest.raises(StopEarlyError):
        crumple.assess(SMALL, [follower()], evidence=tmp_path / "cut", progress=stop_after_share(0.0))
    resumed = crumple.assess(SMALL, [follower()], evidence=tmp_path / "cut")
    assert without_run_info(resumed) == without_run_info(one)


def test_errors_of_an_assessment_are_explained(tmp_path):
    path = write_small_config(tmp_path)
    path.write_text(path.read_text().replace("draws = 20", "draws = -1", 1))
    with pytest.raises(crumple.AssessmentError) as caught:
        crumple.assess(path)
    assert (caught.value.file, caught.value.line, caught.value.field) == (str(path), 4, "draws")
    with pytest.raises(crumple.AssessmentError, match="no-such"):
        crumple.assess(SMALL | {"controllers": ["no-such"]})
    with pytest.raises(crumple.AssessmentError, match="speed"):
        crumple.assess(SMALL | {"speed": 1})
    with pytest.raises(crumple.AssessmentError, match="earlier"):
        crumple.assess(SMALL | {"gates": [{"require": "nothing-worse"}]})
    with pytest.raises(crumple.AssessmentError):
        crumple.assess(SMALL, against=tmp_path / "nothing.json")
    with pytest.raises(crumple.AssessmentError):
        crumple.assess({"version": {1}})


@pytest.mark.parametrize(
    "work",
    [
        "crumple.rate('idm', runs=100_000_000)",
        "crumple.worst_case('paper-1', lambda observation: time.sleep(0.001) or -1.0)",
        "crumple.assess({'version': 1, 'draws': 10_000_000})",
    ],
)
def test_ctrl_c_ends_the_work(work):
    script = textwrap.dedent(f"""
        import signal, time
        import crumple
        # A shell ignores this signal for background processes.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        print("started", flush=True)
        try:
            {work}
        except KeyboardInterrupt:
            print("stopped")
    """)
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "started\n"
        threading.Timer(1.0, process.send_signal, [signal.SIGINT]).start()
        output, _ = process.communicate(timeout=90)
    assert (output, process.returncode) == ("stopped\n", 0)


def test_failures_of_a_contrast_belong_to_one_run():
    found = crumple.falsify("match-leader", "paper", against="idm", budget=60, seed=3)
    assert found.falsified
    for failure in found.failures:
        assert failure.replay().outcome == "collision"
        assert crumple.simulate(failure.scenario, "idm").outcome == "no_collision"
