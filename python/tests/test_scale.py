"""Pickles, threads, executors and pooled counts."""

import copyreg
import hashlib
import itertools
import json
import multiprocessing
import os
import pickle
import re
import subprocess
import sys
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import crumple
from crumple import testing


def brake_late(seen):
    return -8.0 if seen.gap_ahead_m is not None and seen.gap_ahead_m < 10.0 else 0.0


OWN = crumple.Controller(brake_late, interval_s=0.1, name="late", identity="late, version 1")


class HaltonLike:
    def __init__(self, dimension, seed):
        self.random = np.random.default_rng(seed)
        self.dimension = dimension

    def ask(self):
        return self.random.random((8, self.dimension))

    def tell(self, robustness):
        pass


def kill_worker():
    os._exit(9)


class Dying(ThreadPoolExecutor):
    """Executor that loses the tasks with these numbers."""

    def __init__(self, *lost):
        super().__init__(2)
        self.lost = lost
        self.submitted = 0

    def submit(self, fn, /, *args, **kwargs):
        number, self.submitted = self.submitted, self.submitted + 1
        if number not in self.lost:
            return super().submit(fn, *args, **kwargs)
        lost: Future[object] = Future()
        lost.set_exception(RuntimeError("the worker died"))
        return lost


@pytest.fixture(scope="module")
def processes():
    # Workers import crumple anew, as on another machine.
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as executor:
        yield executor


def copy(value):
    return pickle.loads(pickle.dumps(value))


def same_trace(first, second):
    assert np.array_equal(first.time_s, second.time_s)
    for one, other in zip(first.vehicles, second.vehicles, strict=True):
        assert (one.length_m, one.mass_kg, one.in_lane_s) == (other.length_m, other.mass_kg, other.in_lane_s)
        for name in ("position_m", "speed_mps", "acceleration_mps2"):
            assert np.array_equal(getattr(one, name), getattr(other, name))


def same_simulation(first, second):
    for name in ("controller", "outcome", "is_safe", "contact", "failure", "impacts", "vehicles", "interventions"):
        assert getattr(first, name) == getattr(second, name), name
    assert first.scenario == second.scenario
    assert (first.trace is None) == (second.trace is None)
    if first.trace is not None:
        same_trace(first.trace, second.trace)


def samples():
    """Returns a value of each public type."""
    run = crumple.simulate("paper-1", "shield:idm", after_collision="continue")
    small = {"version": 1, "controllers": ["baseline"], "paper": False, "draws": 20, "everyday_draws": 0}
    small |= {"search": {"spaces": ["high-risk"], "budget": 20}, "rates": {"runs": 0}}
    campaign = crumple.falsify("baseline", budget=40)
    counted = crumple.rate("baseline", "high-risk", runs=200)
    return {
        "Assessment": crumple.assess(small),
        "Campaign": campaign,
        "Comparison": crumple.compare("baseline", methods=["uniform"], seeds=1, budget=20),
        "Controller": OWN,
        "Failure": campaign.failures[0],
        "Figure": run.plot(),
        "Observation": crumple.Observation(speed_mps=3.0, acceleration_mps2=-0.5, gap_ahead_m=7.25),
        "PooledRate": crumple.rate.pool([counted]),
        "Rate": counted,
        "Scenario": run.scenario,
        "SearchMethod": crumple.SearchMethod(HaltonLike, "halton-like"),
        "Simulation": run,
        "Space": crumple.space("high-risk"),
        "Trace": run.trace,
        "Track": run.trace.vehicles[0],
        "Training": crumple.train("fast", episodes=1),
        "WorstCase": crumple.worst_case("paper-1", budget=100),
    }


def test_every_public_type_can_be_pickled():
    values = samples()
    public = {name for name in crumple.__all__ if isinstance(getattr(crumple, name), type)}
    errors = {name for name in public if issubclass(getattr(crumple, name), Exception)}
    assert set(values) == public - errors - {"Executor"}
    copies = {name: copy(value) for name, value in values.items()}
    for name, value in values.items():
        assert type(copies[name]) is type(value) is getattr(crumple, name), name
        assert repr(copies[name]) == repr(value) or name in ("Controller", "SearchMethod", "Trace", "Track"), name
    for name in ("Controller", "PooledRate", "Rate", "SearchMethod", "Training", "Scenario", "Comparison"):
        assert copies[name] == values[name], name
    same_simulation(values["Simulation"], copies["Simulation"])
    same_trace(values["Trace"], copies["Trace"])
    assert values["Figure"].svg == copies["Figure"].svg
    assert values["Campaign"].summary == copies["Campaign"].summary
    same_simulation(values["Failure"].replay(), copies["Failure"].replay())
    for name in ("evidence", "gates", "passed"):
        assert getattr(values["Assessment"], name) == getattr(copies["Assessment"], name)
    for name in ("html", "markdown", "files", "_repr_html_", "__str__"):
        assert getattr(values["Assessment"], name)() == getattr(copies["Assessment"], name)()
    for name in errors:
        error = getattr(crumple, name)("message", "file.toml", 3, "field")
        assert (str(copy(error)), copy(error).line, copy(error).field) == ("message", 3, "field")
    assert copy(crumple.rate) is crumple.rate


def test_robustness_of_a_pickled_simulation_is_the_same():
    run = crumple.simulate("paper-1", OWN, dt_s=0.01, after_collision="continue")
    formula = "always v1.time_gap_s > 0.3"
    assert copy(run).robustness(formula) == run.robustness(formula)
    assert copy(run).plot().svg == run.plot().svg


def test_families_and_properties_can_be_pickled():
    scenario = crumple.scenario("paper-1")
    families = [testing.Family.any(), testing.Family.near(scenario), testing.Family.line_of_five()]
    families.append(testing.Family.of_space(crumple.space("paper")))
    for family in families:
        content = bytes(range(200))[: family.byte_count].ljust(family.byte_count, b"\7")
        assert copy(family).read(content) == family.read(content)
    make = testing.Property
    properties = [make.no_avoidable_collision(), make.no_unnecessary_braking(), make.no_amplification()]
    properties += [make.bounded_jerk(5.0), make.specification("always gap_m > 1"), make.not_worse_than("idm")]
    properties += [make.metamorphic("larger-gap=2"), make.deterministic(), make.not_worse_than(OWN)]
    for each in properties:
        again = copy(each)
        assert again.name == each.name
        assert again.evaluate("baseline", scenario, "truth") == each.evaluate("baseline", scenario, "truth")


def test_native_types_need_no_special_registration():
    assert not [cls for cls in copyreg.dispatch_table if cls.__module__.startswith("crumple")]


def thread_count(arguments, **variables):
    program = (
        "import os, crumple\n"
        "before = len(os.listdir('/proc/self/task'))\n"
        f"crumple.simulate('paper-1', trace=False{arguments})\n"
        "print(len(os.listdir('/proc/self/task')) - before)\n"
    )
    cleared = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    result = subprocess.run(
        [sys.executable, "-c", program], env=cleared | variables, check=True, capture_output=True, text=True
    )
    return int(result.stdout)


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="counts threads in /proc")
def test_the_first_setting_determines_the_number_of_threads():
    assert thread_count(", threads=3", RAYON_NUM_THREADS="5") == 3
    assert thread_count("", RAYON_NUM_THREADS="5", OMP_NUM_THREADS="4") == 5
    assert thread_count("", OMP_NUM_THREADS="4,2") == 4
    assert thread_count("", RAYON_NUM_THREADS="0", OMP_NUM_THREADS="") == len(os.sched_getaffinity(0))


@pytest.mark.parametrize("value", ["many", "1025"])
def test_a_variable_without_a_usable_number_is_an_error(value):
    program = "import crumple\ntry: crumple.simulate('paper-1')\nexcept ValueError as error: print(error)"
    environment = os.environ | {"RAYON_NUM_THREADS": "", "OMP_NUM_THREADS": value}
    result = subprocess.run(
        [sys.executable, "-c", program], env=environment, check=True, capture_output=True, text=True
    )
    assert result.stdout == f"OMP_NUM_THREADS: must be a whole number from 0 to 1024, found `{value}`\n"


def test_a_program_may_end_as_soon_as_its_call_returns():
    program = "import crumple\ncrumple.simulate('paper-1', trace=False, threads=64)"
    for _ in range(10):
        subprocess.run([sys.executable, "-c", program], check=True)


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="sets the affinity of this process")
def test_a_worker_with_one_core_starts_one_thread():
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})
    try:
        assert thread_count("") == 1
    finally:
        os.sched_setaffinity(0, cores)


def test_threads_are_in_range():
    for wrong in (0, -1, 1025, 2**70, 1.5, "two"):
        with pytest.raises(ValueError, match="threads: must be a whole number from 1 to 1024, found "):
            crumple.simulate("paper-1", threads=wrong)


@pytest.mark.parametrize("wrong", [-1, 2**70, 1.5, "three", None])
def test_errors_name_the_number_that_is_wrong(wrong):
    space, known = crumple.space("high-risk"), crumple.Controller(brake_late, identity="late")
    calls = [
        ("runs", lambda: crumple.rate(known, runs=wrong)),
        ("resamples", lambda: crumple.rate(known, runs=10, resamples=wrong)),
        ("tasks", lambda: crumple.rate(known, runs=10, tasks=wrong)),
        ("seed", lambda: crumple.rate(known, runs=10, seed=wrong)),
        ("budget", lambda: crumple.falsify(known, budget=wrong)),
        ("seed", lambda: crumple.falsify(known, seed=wrong)),
        ("seeds", lambda: crumple.compare(known, methods=["uniform"], seeds=wrong)),
        ("seed", lambda: crumple.train(seed=[0, wrong])),
        ("index", lambda: space.draw(seed=0, index=wrong)),
        ("seed", lambda: space.draw(seed=wrong, index=0)),
        ("seed", lambda: space.nominal().with_seed(wrong)),
    ]
    for name, call in calls:
        with pytest.raises(crumple.CrumpleError, match=f"^{name}: must be a whole number from ") as raised:
            call()
        assert raised.value.field == name


def test_repeated_seeds_are_refused_before_any_work(tmp_path):
    calls = [
        lambda **options: crumple.falsify("baseline", seed=[3, 5, 3], folder=tmp_path / "falsify", **options),
        lambda **options: crumple.train("fast", [3, 5, 3], tmp_path / "train", **options),
    ]
    with ThreadPoolExecutor(1) as executor:
        for call, options in itertools.product(calls, ({}, {"executor": executor})):
            with pytest.raises(crumple.CrumpleError, match=r"^seed: 3 occurs twice$"):
                call(**options)
    assert not list(tmp_path.iterdir())


def test_errors_about_a_folder_name_arguments_of_python(tmp_path):
    calls = [
        ("folder", lambda: crumple.rate("baseline", runs=30, folder=tmp_path / "rate")),
        ("folder", lambda: crumple.falsify("baseline", budget=20, folder=tmp_path / "falsify")),
        ("out", lambda: crumple.train("fast", 3, tmp_path / "train", episodes=1)),
    ]
    for name, call in calls:
        call()
        advice = rf"^{name}: .* already holds a .*: use resume=True or another {name}$"
        with pytest.raises(crumple.CrumpleError, match=advice) as raised:
            call()
        assert raised.value.field == name
        assert Path(raised.value.file).is_relative_to(tmp_path)
    unknown = crumple.Controller(brake_late)
    crumple.falsify(unknown, budget=20, folder=tmp_path / "unknown")
    with pytest.raises(crumple.CampaignError, match=r"^identity: .* without resume=True, with another folder$"):
        crumple.falsify(unknown, budget=20, folder=tmp_path / "unknown", resume=True)


def test_simulations_on_workers_are_the_same(processes):
    draws = [crumple.space("high-risk").draw(seed=4, index=index) for index in range(40)]
    calls = []
    alone = crumple.simulate(draws, OWN)
    shared = crumple.simulate(draws, OWN, executor=processes, threads=1, progress=lambda *state: calls.append(state))
    assert len(shared) == len(alone) == 40
    for first, second in zip(alone, shared, strict=True):
        same_simulation(first, second)
    assert calls[-1] == (40, 40, sum(not run.is_safe for run in alone))


@pytest.mark.parametrize("against", [None, "baseline"])
def test_counts_on_workers_have_the_same_bits(processes, tmp_path, against):
    def count(folder, **options):
        options |= {"runs": 5300, "against": against, "folder": tmp_path / folder, "confidence": 0.9}
        return crumple.rate("idm", "high-risk", **options)

    alone, shared = count("alone"), count("shared", executor=processes, threads=1)
    assert (shared.tally, shared.certificate) == (alone.tally, alone.certificate)
    for name in ("registration.json", "progress.json", "certificate.json", "work.json"):
        assert (tmp_path / "alone" / name).read_bytes() == (tmp_path / "shared" / name).read_bytes()


def test_a_count_with_a_python_controller_and_threads_as_workers():
    with ThreadPoolExecutor(2) as executor:
        shared = crumple.rate(OWN, "high-risk", runs=4100, executor=executor, threads=1)
    assert shared == crumple.rate(OWN, "high-risk", runs=4100)


def test_a_count_after_a_lost_worker_names_the_runs_and_resumes(tmp_path):
    options = {"runs": 6000, "folder": tmp_path / "count", "confidence": 0.9}
    missing = "2 of 3 tasks have no result: runs 2000 to 3999, runs 4000 to 5999 .RuntimeError: the worker died"
    with Dying(1, 2) as executor, pytest.raises(crumple.WorkerError, match=missing):
        crumple.rate("baseline", "high-risk", executor=executor, **options)
    assert (tmp_path / "count" / "registration.json").exists()
    with ThreadPoolExecutor(1) as executor:
        resumed = crumple.rate("baseline", "high-risk", executor=executor, resume=True, **options)
    assert resumed == crumple.rate("baseline", "high-risk", runs=6000, confidence=0.9)


def test_a_killed_process_is_one_error():
    executor = ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn"))
    with executor:
        executor.submit(kill_worker)
        with pytest.raises(crumple.WorkerError, match="have no result: "):
            crumple.rate("baseline", "high-risk", runs=4000, executor=executor)


def test_an_executor_without_submit_is_refused_before_any_work(tmp_path):
    calls = [
        lambda executor: crumple.simulate(["paper-1"], executor=executor),
        lambda executor: crumple.rate("baseline", runs=100, folder=tmp_path / "rate", executor=executor),
        lambda executor: crumple.falsify("baseline", seed=[0, 1], folder=tmp_path / "falsify", executor=executor),
        lambda executor: crumple.compare("baseline", methods=["uniform"], executor=executor),
        lambda executor: crumple.train("fast", [0, 1], tmp_path / "train", executor=executor),
    ]
    for call in calls:
        for wrong in (3, "processes", ThreadPoolExecutor):
            with pytest.raises(TypeError, match=r"executor: must be an object with the method `submit`, .* found "):
                call(wrong)
    assert not list(tmp_path.iterdir())


def test_equal_counts_have_equal_reports(tmp_path):
    first, second = (crumple.rate("baseline", "high-risk", runs=300, seed=5) for _ in range(2))
    assert (first.data, first.text) == (second.data, second.text)
    assert (first.data.get("folder"), first.data["certificate"]) == (None, "certificate.json")
    in_folder = crumple.rate("baseline", "high-risk", runs=300, seed=5, folder=tmp_path / "rate")
    assert in_folder.data["folder"] == str(tmp_path / "rate")
    assert in_folder.text.replace(f"{tmp_path / 'rate'}{os.sep}", "") == first.text


def test_errors_of_tasks_are_those_of_one_machine(processes):
    with pytest.raises(crumple.ControllerError, match="no-such-controller"):
        crumple.rate("no-such-controller", runs=100, executor=processes)
    with pytest.raises(crumple.RunError):
        crumple.simulate(["paper-1"] * 20, dt_s=0.033, executor=processes)
    with pytest.raises(crumple.CampaignError, match="no-such-method"):
        crumple.falsify("baseline", method="no-such-method", seed=[0, 1], executor=processes)


def test_campaigns_of_several_seeds(processes, tmp_path):
    alone = crumple.falsify("baseline", budget=60, seed=[3, 5], folder=tmp_path / "alone")
    shared = crumple.falsify("baseline", budget=60, seed=range(3, 6, 2), executor=processes)
    single = crumple.falsify("baseline", budget=60, seed=5)
    assert [each.text for each in shared] == [each.text for each in alone]
    assert shared[1].summary == alone[1].summary == single.summary
    assert (tmp_path / "alone" / "seed-5" / "summary.json").exists()
    same_simulation(shared[0].failures[0].replay(), alone[0].failures[0].replay())


def test_comparisons_on_workers_are_the_same(processes):
    methods = ["uniform", crumple.SearchMethod(HaltonLike, "own")]
    options = {"methods": methods, "seeds": 4, "budget": 40, "seed": 7}
    assert crumple.compare("match-leader", executor=processes, **options) == crumple.compare("match-leader", **options)


def test_training_gives_the_bytes_of_the_program(processes, tmp_path):
    calls = []
    preset = crumple.training_preset("fast")
    alone = crumple.train(preset, 3, tmp_path / "out", episodes=4, progress=lambda *state: calls.append(state))
    assert calls[-1][:2] == (4, 4)
    assert alone.seed == 3
    shared = crumple.train("fast", [3, 4], episodes=4, executor=processes)
    assert shared[0] == alone
    assert shared[1].seed == 4
    resumed = crumple.train("fast", 3, tmp_path / "out", episodes=4, resume=True)
    assert resumed == alone
    with pytest.raises(crumple.TrainingError, match="seed-3"):
        crumple.train("fast", 3, tmp_path / "out", episodes=4)
    with pytest.raises(crumple.TrainingError, match="no-such-space"):
        crumple.train("fast", spaces={"no-such-space": 0.5}, episodes=1)
    with pytest.raises(crumple.TrainingError, match=r"saved as \.safetensors"):
        alone.save(tmp_path / "policy.bin")


@pytest.mark.skipif("CRUMPLE" not in os.environ, reason="compares with the program")
def test_training_in_python_equals_the_command(tmp_path):
    crumple.train("fast", 2, tmp_path / "python", episodes=3)
    command = [os.environ["CRUMPLE"], "train", "--seed", "2", "--episodes", "3", "--out", str(tmp_path / "program")]
    subprocess.run([*command, "--quiet"], check=False, capture_output=True)
    # A checkpoint also states the build.
    for name in ("log.jsonl", "result.json"):
        python, program = (tmp_path / folder / "seed-2" / name for folder in ("python", "program"))
        assert python.read_bytes() == program.read_bytes(), name


def test_a_count_in_which_every_run_fails_is_pooled():
    options = {"runs": 30, "estimator": "truth", "confidence": 0.9}
    counts = [crumple.rate("baseline", "high-risk", seed=seed, **options) for seed in (0, 1)]
    assert [count.failures for count in counts] == [29, 30]
    assert counts[1].rate_at_most == 1.0
    assert counts[1].words.startswith("rate: no bound below 1 at confidence 0.9")
    pooled = crumple.rate.pool(counts, seeds=range(2))
    assert (pooled.failures, pooled.runs) == (59, 60)
    # Root p of 1 - p^60 = 0.1.
    assert abs(pooled.rate_at_most - 0.9 ** (1 / 60)) < 1e-7
    assert crumple.rate.pool(counts[1:]).rate_at_most == 1.0


def test_counts_of_a_python_controller_are_pooled_if_its_identity_is_a_hash():
    identity = hashlib.sha256(Path(__file__).read_bytes()).hexdigest()
    known = crumple.Controller(brake_late, interval_s=0.1, name="late", identity=identity)
    counts = [crumple.rate(known, "high-risk", runs=50, seed=seed) for seed in (0, 1)]
    assert counts[0].certificate["statement"]["rate"]["registration"]["configuration"]["controller_sha256"] == identity
    assert crumple.rate.pool(counts, seeds=range(2)).failures == counts[0].failures + counts[1].failures
    other = crumple.rate(OWN, "high-risk", runs=50)
    assert other.certificate is None
    needed = r"only if the `identity` of each controller in Python is a SHA-256"
    assert re.search(needed, other.words)
    with pytest.raises(crumple.RateError, match=rf"^identity: the controller `python` states none; .* {needed}"):
        crumple.rate(crumple.Controller(brake_late), "high-risk", runs=50)
    with pytest.raises(crumple.RateError, match=r"cannot be pooled: `registration\.configuration\.controller_sha256`"):
        crumple.rate.pool([other])


class Counting(ThreadPoolExecutor):
    """Executor that counts tasks."""

    submitted = 0

    def submit(self, fn, /, *args, **kwargs):
        self.submitted += 1
        return super().submit(fn, *args, **kwargs)


def test_tasks_limits_the_number_of_tasks():
    draws = [crumple.space("high-risk").draw(seed=4, index=index) for index in range(40)]
    for tasks, expected in ((1, 1), (2, 2), (1000, 3)):
        with Counting(2) as executor:
            shared = crumple.rate("idm", "high-risk", runs=5300, executor=executor, tasks=tasks, threads=1)
            assert executor.submitted == expected
        assert shared == crumple.rate("idm", "high-risk", runs=5300)
        with Counting(2) as executor:
            crumple.simulate(draws, "idm", executor=executor, tasks=tasks, trace=False, threads=1)
            assert executor.submitted == expected
    for tasks in (0, 1001, 2.5, None):
        with pytest.raises(crumple.RateError, match="tasks: must be a whole number from 1 to 1000"):
            crumple.rate("idm", runs=100, tasks=tasks)
        with pytest.raises(crumple.RunError, match="tasks: must be a whole number from 1 to 1000"):
            crumple.simulate(draws, "idm", tasks=tasks)


def test_pools_of_counts(tmp_path):
    counts = [crumple.rate("baseline", "high-risk", runs=300, seed=seed) for seed in range(5, 9)]
    pooled = crumple.rate.pool(counts)
    assert (pooled.runs, pooled.seeds) == (1200, range(5, 9))
    assert pooled.failures == sum(count.failures for count in counts)
    assert pooled.failures / pooled.runs < pooled.rate_at_most < min(count.rate_at_most for count in counts)
    assert str(pooled) == pooled.text
    files = [tmp_path / f"{index}.json" for index in range(4)]
    for file, count in zip(files, counts, strict=True):
        file.write_text(json.dumps(count.certificate))
    assert crumple.rate.pool(reversed(files)) == pooled
    assert pooled.data["assumptions"][-1] == "the range of seeds was fixed before the first run"
    assert all(f"  assuming that {each}\n" in pooled.text for each in pooled.data["assumptions"])
    for single in (str(files[0]), files[0], counts[0], counts[0].certificate):
        with pytest.raises(TypeError, match="counts: must be a list of results, certificates or paths, found a single"):
            crumple.rate.pool(single)
    with pytest.raises(crumple.RateError, match="seed 6 occurs twice"):
        crumple.rate.pool([*counts, counts[1]])
    with pytest.raises(
        crumple.RateError, match="the seeds 5 to 8 are incomplete: 1 seed is missing, the first of them is 7"
    ):
        crumple.rate.pool([counts[0], counts[1], counts[3]])
    assert not pooled.is_expected_range
    expected = crumple.rate.pool(counts, seeds=range(5, 9))
    assert expected.is_expected_range
    assert (expected.seeds, expected.rate_at_most) == (pooled.seeds, pooled.rate_at_most)
    missing = "the seeds 5 to 9 are incomplete: 1 seed is missing, the first of them is 9"
    with pytest.raises(crumple.RateError, match=missing):
        crumple.rate.pool(counts, seeds=range(5, 10))
    with pytest.raises(crumple.RateError, match="seed 8 is outside the expected range 5-7"):
        crumple.rate.pool(counts, seeds=range(5, 8))
    for wrong in (4, [5, 6, 7, 8], range(5, 5), range(5, 9, 2)):
        with pytest.raises(TypeError, match="seeds: must be a range, such as range"):
            crumple.rate.pool(counts, seeds=wrong)
    with pytest.raises(crumple.RateError, match="seeds: must be a whole number from 0 to"):
        crumple.rate.pool(counts, seeds=range(-1, 3))
    with pytest.raises(crumple.RateError, match=r"`registration\.runs` differs"):
        crumple.rate.pool([counts[0], crumple.rate("baseline", "high-risk", runs=400, seed=6)])
