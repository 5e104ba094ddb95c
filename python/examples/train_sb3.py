"""Trains PPO, SAC and TD3 of Stable-Baselines3 on crumple's task, and assesses the models and crumple's policy.

    pip install "../[gym]" stable-baselines3
    python train_sb3.py 200000

Writes ppo.zip, sac.zip, td3.zip and the report `sb3-report/`. A model has the observation of crumple's policies, so
its file is a controller: `crumple falsify --controller sac.zip`.
"""

import sys

from sb3_vec_env import PlatoonVecEnv
from stable_baselines3 import PPO, SAC, TD3

import crumple

SPACE = "high-risk"


def train(algorithm, name, steps, **settings):
    """Trains and saves one model; returns the path of its file."""
    env = PlatoonVecEnv(64, space=SPACE, estimator="truth")
    env.seed(0)
    model = algorithm("MlpPolicy", env, seed=0, device="cpu", policy_kwargs={"net_arch": [64, 64]}, **settings)
    model.learn(steps)
    model.save(name)
    return f"{name}.zip"


def main(steps):
    """Trains and assesses the models, writes the report, and returns the assessment."""
    off_policy = {"learning_starts": min(10_000, steps // 2), "train_freq": 1, "gradient_steps": 1, "batch_size": 256}
    files = [
        train(PPO, "ppo", steps, n_steps=64, batch_size=512),
        train(SAC, "sac", steps, **off_policy),
        train(TD3, "td3", steps, **off_policy),
    ]
    for file in files:
        found = crumple.falsify(file, SPACE, budget=100)
        print(f"{file}: {found.summary['methods'][1]['failures']} of 100 uniform draws fail")
    assessment = crumple.assess(
        {
            "version": 1,
            "controllers": ["baseline", "policy", *files],
            "subject": files[1],
            "paper": False,
            "draws": 200,
            "everyday_draws": 20,
            "search": {"spaces": [SPACE], "budget": 50},
            "rates": {"runs": 0},
        }
    )
    print(assessment)
    print(f"wrote {crumple.write_report(assessment, 'sb3-report')}")
    return assessment


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 200_000)
