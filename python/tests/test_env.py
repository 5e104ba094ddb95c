"""Tests of the Gymnasium environments."""

import os
import resource
import subprocess
import sys

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import crumple
from crumple.env import PlatoonEnv, PlatoonVectorEnv


def held_random_actions(seed, steps, count):
    """Returns actions that are held for ten steps, so that some episodes end in a collision."""
    random = np.random.default_rng(seed)
    drawn = random.uniform(-1, 1, (steps // 10 + 1, count, 1)).astype(np.float32)
    return np.repeat(drawn, 10, axis=0)[:steps]


@pytest.mark.filterwarnings("error")
def test_gymnasium_accepts_the_environment():
    check_env(gymnasium.make("crumple/Platoon-v0", space="paper").unwrapped)
    vector = gymnasium.make_vec("crumple/Platoon-v0", num_envs=3, vectorization_mode="vector_entry_point")
    assert isinstance(vector, PlatoonVectorEnv)


@pytest.mark.parametrize("estimator", ["truth", "kalman"])
@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_a_vector_environment_equals_single_environments(mode, estimator):
    count, steps = 37, 400
    several = SyncVectorEnv(
        [lambda: PlatoonEnv("high-risk", estimator=estimator)] * count, autoreset_mode=mode, copy=True
    )
    together = PlatoonVectorEnv(count, "high-risk", estimator=estimator, autoreset_mode=mode)
    assert np.array_equal(several.reset(seed=5)[0], together.reset(seed=5)[0])
    endings = set()
    for actions in held_random_actions(1, steps, count):
        expected, results = several.step(actions), together.step(actions)
        for one, other in zip(expected[:4], results[:4], strict=True):
            assert np.array_equal(np.asarray(one, np.float32), np.asarray(other, np.float32))
        endings |= set(results[4]["ending"].tolist())
        ended = results[2] | results[3]
        if mode == AutoresetMode.SAME_STEP and ended.any():
            for index in np.flatnonzero(ended):
                assert np.array_equal(expected[4]["final_obs"][index], results[4]["final_obs"][index])
        if mode == AutoresetMode.DISABLED and ended.any():
            options = {"reset_mask": ended}
            assert np.array_equal(several.reset(options=dict(options))[0], together.reset(options=options)[0])
    assert {0, 1} <= endings, "no episode ended in collision"


def test_invalid_actions_are_refused_before_a_step():
    env = PlatoonVectorEnv(40, "high-risk")
    before, _ = env.reset(seed=3)
    actions = np.zeros((40, 1), np.float32)
    actions[20] = np.nan
    with pytest.raises(crumple.TrainingError, match="environment 20: its action is not a number"):
        env.step(actions)
    moved, *_ = env.step(np.zeros((40, 1)))
    fresh = PlatoonVectorEnv(40, "high-risk")
    assert np.array_equal(fresh.reset(seed=3)[0], before)
    assert np.array_equal(fresh.step(np.zeros((40, 1)))[0], moved)
    wrong_actions = [np.zeros((1, 40)), np.zeros((20, 2)), np.zeros((40, 1), complex), ["0"] * 40, np.zeros(39)]
    for wrong in wrong_actions:
        with pytest.raises(
            crumple.TrainingError, match=r"actions are 40 numbers, in an array of shape \(40, 1\), found"
        ):
            env.step(wrong)
    for seed in (-1, 1.5, 2**64 - 20, [1, 2], [1.5] * 40, np.array([-1] * 40)):
        with pytest.raises(crumple.TrainingError, match="seed"):
            env.reset(seed=seed)
    for mask in (np.ones(39, bool), np.ones((40, 1), bool), [0, 2] * 20):
        with pytest.raises(crumple.TrainingError, match="reset_mask"):
            env.reset(options={"reset_mask": mask})
    assert np.array_equal(env.step(np.zeros((40, 1)))[0], fresh.step(np.zeros((40, 1)))[0])
    never = PlatoonVectorEnv(2)
    with pytest.raises(crumple.TrainingError, match="environment 0: an episode that is over, or has not begun"):
        never.step(np.zeros((2, 1)))
    with pytest.raises(crumple.TrainingError):
        never.reset(seed=[1, 2, 3])
    assert not np.array_equal(never.reset()[0], PlatoonVectorEnv(2).reset(seed=0)[0]), "a refused seed has no effect"


def test_returned_arrays_are_valid_actions():
    env, other = (PlatoonVectorEnv(3, copy=copies) for copies in (False, True))
    env.reset(seed=1), other.reset(seed=1)
    for _ in range(5):
        rewards = env.step(np.zeros((3, 1)))[1]
        expected = other.step(np.zeros((3, 1)))[1].copy()
        assert np.array_equal(env.step(rewards)[0], other.step(expected)[0])


FORKED = """
import faulthandler, multiprocessing, numpy, crumple
from crumple.env import PlatoonVectorEnv
env = PlatoonVectorEnv(64)
env.reset(seed=0)
def child():
    faulthandler.dump_traceback_later(60, exit=True)
    expected = env.step(numpy.zeros((64, 1)))[0]
    other = PlatoonVectorEnv(64)
    other.reset(seed=0)
    assert numpy.array_equal(other.step(numpy.zeros((64, 1)))[0], expected)
    assert len(crumple.simulate(["paper-1"] * 50, lambda observation: -1.0)) == 50
process = multiprocessing.get_context("fork").Process(target=child)
process.start()
process.join()
assert process.exitcode == 0
"""

LEFT = """
import threading, time, crumple
def slow_controller(observation):
    time.sleep(0.0005)
    return -1.0
threading.Thread(target=lambda: crumple.falsify(slow_controller, "high-risk", budget=100_000), daemon=True).start()
time.sleep(1.0)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="processes are forked on Linux")
@pytest.mark.parametrize("script", [FORKED, LEFT], ids=["forked", "left"])
@pytest.mark.parametrize("threads", ["1", "2"])
def test_processes_can_fork_and_exit(script, threads):
    environment = os.environ | {"RAYON_NUM_THREADS": threads}
    done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr


def test_a_controller_that_simulates_is_refused_for_any_number_of_runs():
    def controller(observation):
        crumple.simulate("paper-1", "idm", trace=False)
        return 0.0

    for runs in (1, 3, 40):
        for run in crumple.simulate(["paper-1"] * runs, controller):
            assert "a controller cannot begin simulations of its own" in run.failure


def test_environments_without_a_seed_continue_their_sequence():
    together = PlatoonVectorEnv(3, "high-risk")
    several = SyncVectorEnv([lambda: PlatoonEnv("high-risk")] * 3)
    for seed in (5, [1, None, 2], None, np.array([None, 7, None]), [None] * 3):
        assert np.array_equal(several.reset(seed=seed)[0], together.reset(seed=seed)[0]), seed
    # The first scenario of an environment without a seed is random.
    first, second = (PlatoonVectorEnv(3, "high-risk").reset(seed=[1, None, 2])[0] for _ in range(2))
    assert np.array_equal(first[[0, 2]], second[[0, 2]])
    assert not np.array_equal(first[1], second[1])
    # Also if only other environments were reset before.
    first, second = PlatoonVectorEnv(2, "high-risk"), PlatoonVectorEnv(2, "high-risk")
    for env in (first, second):
        env.reset(seed=[3, None], options={"reset_mask": np.array([True, False])})
    assert not np.array_equal(first.reset()[0][1], second.reset()[0][1])


def test_a_seed_determines_results_for_any_number_of_threads():
    def drive(count):
        env = PlatoonVectorEnv(count, "high-risk")
        states = [env.reset(seed=3)[0][:20]]
        states += [env.step(np.resize(actions, (count, 1)))[0][:20] for actions in held_random_actions(2, 50, 20)]
        return np.stack(states)

    # 20 episodes use one or two threads, 300 use many.
    assert np.array_equal(drive(20), drive(300))


def test_steps_reuse_arrays_without_copy():
    env = PlatoonVectorEnv(4, copy=False)
    first = env.reset(seed=0)[0]
    second = env.step(np.zeros((4, 1), np.float32))[0]
    assert first is second
    copying = PlatoonVectorEnv(4)
    assert copying.reset(seed=0)[0] is not copying.step(np.zeros((4, 1), np.float32))[0]


def test_the_acceleration_range_is_that_of_the_preset():
    env = PlatoonEnv("paper", estimator="truth")
    low, high = env.acceleration_range_mps2
    assert (low, high) == (-7.5, 3.0)
    assert env.decision_s == pytest.approx(0.1)


def test_errors_are_explained():
    env = PlatoonVectorEnv(2, autoreset_mode=AutoresetMode.DISABLED)
    actions = np.zeros((2, 1), np.float32)
    with pytest.raises(crumple.TrainingError, match="reset"):
        env.step(actions)
    env.reset(seed=0)
    with pytest.raises(crumple.TrainingError, match="not a number"):
        env.step(actions * np.nan)
    with pytest.raises(crumple.TrainingError, match="3"):
        env.step(np.zeros((3, 1), np.float32))
    with pytest.raises(crumple.TrainingError, match="preset"):
        PlatoonEnv(preset="no-such")
    with pytest.raises(crumple.SpaceError):
        PlatoonEnv("no-such")
    with pytest.raises(crumple.TrainingError, match="num_envs: must be a whole number from 1"):
        PlatoonVectorEnv(0)
    # Only vehicle 1 may be under test.
    everybody = crumple.space("paper").to_dict()
    with pytest.raises(crumple.TrainingError, match="under test"):
        PlatoonEnv('version = 1\nname = "n"\nbase = "paper-3"\n' + friction_parameter())
    assert everybody["name"] == "paper"


def friction_parameter():
    return (
        '[[parameters]]\nname = "f"\nfield = "environment.friction"\nunit = "1"\n'
        "distribution.uniform = { low = 0.9, high = 1.0 }\n"
    )


def resident_bytes():
    """Returns the resident memory of the process."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * resource.getpagesize()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_memory_does_not_grow():
    env = PlatoonVectorEnv(500, estimator="truth", autoreset_mode=AutoresetMode.DISABLED)
    scenarios = [crumple.space("paper").draw(0, index) for index in range(20)]

    def live(resets, traces):
        for _ in range(resets // 500):
            env.reset()
            env.step(np.zeros((500, 1), np.float32))
        for _ in range(traces // 20):
            crumple.simulate(scenarios, "baseline", "truth")
        crumple.simulate(scenarios, lambda observation: -1.0, "truth")
        crumple.monitor("always x > 0", {"x": np.ones((resets // 100, 100))})

    live(10_000, 100)
    before = resident_bytes()
    # The traces take a gigabyte if they leak.
    live(1_000_000, 10_000)
    assert resident_bytes() - before < 8 << 20


def test_costs_have_the_weight_of_the_space():
    def costs(times):
        preset = crumple.training_preset("road").split("[[spaces]]")[0]
        preset += f'[environment.costs]\njerk = 1\n[[spaces]]\nspace = "traffic"\nweight = 1\ncosts_times = {times}\n'
        env = PlatoonEnv(None, preset=preset)
        env.reset(seed=2)
        rewards = [env.step(np.full(1, action, np.float32))[1] for action in (0.9, -0.5, 0.9, -0.5)]
        return 1.0 - np.array(rewards)

    once = costs(1)
    assert once.min() > 0.01
    assert costs(0) == pytest.approx(np.zeros(4), abs=1e-6)
    assert costs(10) == pytest.approx(10 * once, rel=1e-4)
