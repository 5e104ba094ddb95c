"""The Gymnasium environments."""

import resource
import sys

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import crumple
from crumple.env import PlatoonEnv, PlatoonVectorEnv


def actions_of(seed, steps, count):
    """Actions that are held for a while, so that some episodes end in contact."""
    random = np.random.default_rng(seed)
    drawn = random.uniform(-1, 1, (steps // 10 + 1, count, 1)).astype(np.float32)
    return np.repeat(drawn, 10, axis=0)[:steps]


@pytest.mark.filterwarnings("error")
def test_gymnasium_knows_the_environment_and_finds_nothing_wrong_with_it():
    check_env(gymnasium.make("crumple/Platoon-v0", space="paper").unwrapped)
    vector = gymnasium.make_vec("crumple/Platoon-v0", num_envs=3, vectorization_mode="vector_entry_point")
    assert isinstance(vector, PlatoonVectorEnv)


@pytest.mark.parametrize("estimator", ["truth", "kalman"])
@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_the_vector_steps_to_the_bit_as_its_environments_alone(mode, estimator):
    count, steps = 37, 400
    several = SyncVectorEnv([lambda: PlatoonEnv("high-risk", estimator=estimator)] * count, autoreset_mode=mode, copy=True)
    together = PlatoonVectorEnv(count, "high-risk", estimator=estimator, autoreset_mode=mode)
    assert np.array_equal(several.reset(seed=5)[0], together.reset(seed=5)[0])
    endings = set()
    for actions in actions_of(1, steps, count):
        wanted, told = several.step(actions), together.step(actions)
        for one, other in zip(wanted[:4], told[:4], strict=True):
            assert np.array_equal(np.asarray(one, np.float32), np.asarray(other, np.float32))
        endings |= set(told[4]["ending"].tolist())
        ended = told[2] | told[3]
        if mode == AutoresetMode.SAME_STEP and ended.any():
            for index in np.flatnonzero(ended):
                assert np.array_equal(wanted[4]["final_obs"][index], told[4]["final_obs"][index])
        if mode == AutoresetMode.DISABLED and ended.any():
            options = {"reset_mask": ended}
            assert np.array_equal(several.reset(options=dict(options))[0], together.reset(options=options)[0])
    assert {0, 1} <= endings, "no episode ended in contact"


def test_one_seed_decides_everything_on_any_number_of_threads():
    def drive(count):
        env = PlatoonVectorEnv(count, "high-risk")
        states = [env.reset(seed=3)[0][:20]]
        states += [env.step(np.resize(actions, (count, 1)))[0][:20] for actions in actions_of(2, 50, 20)]
        return np.stack(states)

    # 20 fit on a thread or two, 300 on many.
    assert np.array_equal(drive(20), drive(300))


def test_a_step_writes_into_its_own_arrays_if_the_caller_wants_that():
    env = PlatoonVectorEnv(4, copy=False)
    first = env.reset(seed=0)[0]
    second = env.step(np.zeros((4, 1), np.float32))[0]
    assert first is second
    kept = PlatoonVectorEnv(4)
    assert kept.reset(seed=0)[0] is not kept.step(np.zeros((4, 1), np.float32))[0]


def test_an_action_is_the_acceleration_it_stands_for():
    env = PlatoonEnv("paper", estimator="truth")
    low, high = env.acceleration_range_mps2
    assert (low, high) == (-7.5, 3.0)
    assert env.decision_s == pytest.approx(0.1)


def test_what_is_wrong_is_said():
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
    with pytest.raises(ValueError, match="environments"):
        PlatoonVectorEnv(0)
    # Vehicle 1 alone must be under test.
    everybody = crumple.space("paper").to_dict()
    with pytest.raises(crumple.TrainingError, match="under test"):
        PlatoonEnv('version = 1\nname = "n"\nbase = "paper-3"\n' + one_parameter())
    assert everybody["name"] == "paper"


def one_parameter():
    return (
        '[[parameters]]\nname = "f"\nfield = "environment.friction"\nunit = "1"\n'
        "distribution.uniform = { low = 0.9, high = 1.0 }\n"
    )


def used_bytes():
    """The process's memory now."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * resource.getpagesize()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_memory_stays_as_it_is():
    env = PlatoonVectorEnv(500, estimator="truth", autoreset_mode=AutoresetMode.DISABLED)
    scenarios = [crumple.space("paper").draw(0, index) for index in range(20)]

    def live(resets, traces):
        for _ in range(resets // 500):
            env.reset()
            env.step(np.zeros((500, 1), np.float32))
        for _ in range(traces // 20):
            crumple.simulate(scenarios, "baseline", "truth")
        crumple.simulate(scenarios, lambda seen: -1.0, "truth")
        crumple.monitor("always x > 0", {"x": np.ones((resets // 100, 100))})

    live(10_000, 100)
    before = used_bytes()
    # A gigabyte of traces alone, were they kept.
    live(1_000_000, 10_000)
    assert used_bytes() - before < 8 << 20


def test_costs_count_as_often_as_the_space_says():
    def costs(times):
        preset = crumple.training_preset("road").split("[[spaces]]")[0]
        preset += f'[[spaces]]\nspace = "traffic"\nweight = 1\ncosts_times = {times}\n'
        env = PlatoonEnv(None, preset=preset)
        env.reset(seed=2)
        rewards = [env.step(np.full(1, action, np.float32))[1] for action in (0.9, -0.5, 0.9, -0.5)]
        return 1.0 - np.array(rewards)

    once = costs(1)
    assert once.min() > 0.01
    assert costs(0) == pytest.approx(np.zeros(4), abs=1e-6)
    assert costs(10) == pytest.approx(10 * once, rel=1e-4)
