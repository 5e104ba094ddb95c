"""Tunes the costs of a training's reward with Optuna, for few collisions and little unnecessary braking.

    pip install "../[gym]" stable-baselines3 optuna
    python tune_reward.py 20 50000

The result is a preset of `crumple train`.
"""

import sys
import tempfile
from pathlib import Path

import optuna
from sb3_vec_env import PlatoonVecEnv
from stable_baselines3 import PPO

import crumple


def preset_with_costs(costs):
    """Returns the preset `fast` with these costs, as a text."""
    lines = "".join(f"{name} = {value!r}\n" for name, value in costs.items())
    return f"{crumple.training_preset('fast')}\n[environment.costs]\n{lines}"


def score(costs, steps):
    """Trains with these costs; returns the collision rate in danger, and the mean peak braking in traffic in m/s²."""
    env = PlatoonVecEnv(64, space="high-risk", estimator="truth", preset=preset_with_costs(costs))
    env.seed(0)
    model = PPO("MlpPolicy", env, seed=0, device="cpu", n_steps=64, batch_size=512)
    model.learn(steps)
    with tempfile.TemporaryDirectory() as folder:
        model.save(Path(folder) / "model")
        file = str(Path(folder) / "model.zip")
        danger = [crumple.space("high-risk").draw(1, index) for index in range(200)]
        traffic = [crumple.space("traffic").draw(1, index) for index in range(50)]
        collisions = sum(not run.is_safe for run in crumple.simulate(danger, file, "truth", trace=False))
        calm = [run.vehicles[1]["max_brake_mps2"] for run in crumple.simulate(traffic, file, "truth", trace=False)]
    return collisions / len(danger), sum(calm) / len(calm)


def main(trials, steps):
    """Tunes the costs and returns the study."""

    def objective(trial):
        costs = {name: trial.suggest_float(name, 0.0, 1.0) for name in ("far", "relative_speed", "unnecessary_braking")}
        collisions, braking_mps2 = score(costs, steps)
        trial.set_user_attr("collisions", collisions)
        return collisions + 0.02 * braking_mps2

    study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=0))
    study.optimize(objective, n_trials=trials)
    print(f"best: {study.best_value:.3f} with {study.best_params}")
    return study


if __name__ == "__main__":
    main(*(int(word) for word in sys.argv[1:3]) if len(sys.argv) > 2 else (20, 50_000))
