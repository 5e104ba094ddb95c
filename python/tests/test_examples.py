"""Tests of the examples with small budgets."""

from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(EXAMPLES)


def test_a_simple_acc_is_falsified(tmp_path):
    import falsify_acc

    failures = falsify_acc.main(60)
    assert failures
    assert (tmp_path / "acc-fails.svg").exists()


def test_optuna_searches_for_failures():
    pytest.importorskip("optuna")
    import optuna_search

    compared = optuna_search.main(2, 60)
    assert [method["method"] for method in compared.data["methods"]] == ["optuna", "auto", "uniform"]
    assert compared.data["methods"][0]["falsified"] > 0


def test_models_are_trained_and_evaluated(tmp_path):
    pytest.importorskip("stable_baselines3")
    import train_sb3

    assessment = train_sb3.main(3000)
    compared = assessment.evidence["provenance"]["config"]["controllers"]
    assert compared == ["baseline", "policy", "ppo.zip", "sac.zip", "td3.zip"]
    assert (tmp_path / "sb3-report/assessment.html").exists()


def test_a_model_drives_alike_in_crumple_and_python():
    pytest.importorskip("stable_baselines3")
    import numpy as np
    from sb3_vec_env import PlatoonVecEnv
    from stable_baselines3 import TD3

    import crumple

    env = PlatoonVecEnv(8, space="paper", estimator="truth")
    model = TD3("MlpPolicy", env, seed=0, device="cpu", learning_starts=10)
    model.learn(200)
    model.save("td3")
    offset = np.array([16, 16, 12.5, 12.5, 12.5, 0, 0, 0])
    scale = np.array([16, 16, 12.5, 12.5, 12.5, 5, 5, 5])

    def predicted(rows):
        states = ((rows - offset) / scale).clip(-4, 4).astype(np.float32)
        return -2.25 + 5.25 * model.predict(states, deterministic=True)[0][:, 0].astype(float)

    mine = crumple.Controller(predicted, batch=True, interval_s=0.1)
    draws = [crumple.space("paper").draw(0, index) for index in range(5)]
    for one, other in zip(crumple.simulate(draws, "td3.zip"), crumple.simulate(draws, mine), strict=True):
        if len(one.trace) == len(other.trace):
            difference = one.trace.vehicles[1].position_m - other.trace.vehicles[1].position_m
            assert np.abs(difference).max() < 1e-3
        else:
            assert abs(one.collision["time_s"] - other.collision["time_s"]) < 0.01


def test_the_adapter_returns_the_results_of_the_environment():
    pytest.importorskip("stable_baselines3")
    import numpy as np
    from gymnasium.vector import AutoresetMode
    from sb3_vec_env import PlatoonVecEnv

    from crumple.env import PlatoonVectorEnv

    adapted = PlatoonVecEnv(5, space="high-risk", estimator="truth")
    adapted.seed(3)
    plain = PlatoonVectorEnv(5, "high-risk", estimator="truth", autoreset_mode=AutoresetMode.SAME_STEP)
    assert np.array_equal(adapted.reset(), plain.reset(seed=3)[0])
    ended = 0
    for _ in range(300):
        actions = np.full((5, 1), 0.4, np.float32)
        states, rewards, over, infos = adapted.step(actions)
        expected = plain.step(actions)
        assert np.array_equal(states, expected[0])
        assert np.array_equal(rewards, expected[1])
        for index in np.flatnonzero(over):
            assert np.array_equal(infos[index]["terminal_observation"], expected[4]["final_obs"][index])
            ended += 1
    assert ended > 0


def test_a_reward_is_tuned():
    pytest.importorskip("stable_baselines3")
    pytest.importorskip("optuna")
    import tune_reward

    study = tune_reward.main(2, 1000)
    assert len(study.trials) == 2
