"""Configuration of the study, and its runs."""

import itertools
import json
import subprocess
import sys
import tomllib
from pathlib import Path

from drives import read

HERE = Path(__file__).resolve().parent
SPACE = HERE.parent / "emergencies.toml"
CONFIG = HERE.parent / "aeb-behind.toml"
QUESTIONS = tomllib.loads((HERE / "questions.toml").read_text())
SYSTEMS = tomllib.loads(CONFIG.read_text())["controllers"]
# Drivers of crumple that observe the vehicle behind. They were added after the run: no question names them.
ADDED = ["predictive", "road"]
NONE, BRAKE, HUMAN, ASSISTED, CONFORMING = ("emergency-brake,ttc_s=0", "emergency-brake,ttc_s=2", "human",
                                            "human,aeb_ttc_s=1.4", "human,aeb_ttc_s=2")
CONDITIONS = list(itertools.product(QUESTIONS["assumptions"]["after_collision"], QUESTIONS["assumptions"]["estimator"]))
CONFORMING_SPACES = {"followers-alone": "human", "followers-conforming": CONFORMING}


def driver(name):
    """Returns a driver of a scenario file from its text on the command line."""
    kind, *settings = name.split(",")
    if not settings:
        return f'driver = "{kind}"'
    return f"driver.{kind} = {{ {', '.join(setting.replace('=', ' = ') for setting in settings)} }}"


def replaced(text, *pairs):
    for old, new in pairs:
        if text.count(old) != 1:
            sys.exit(f"error: `{old}` is not once in the file")
        text = text.replace(old, new)
    return text


def space_with_follower(name, follower, *changes):
    """Returns the text of the space with one driver of the vehicle behind."""
    text = SPACE.read_text()
    start = text.index('[[parameters]]\nname = "follower"\n')
    text = text[:start] + text[text.index("[[parameters]]", start + 5):]
    return replaced(text, (f'name = "emergencies"\nabout = """', f'name = "{name}"\nabout = """'),
                    ('driver = "human"', driver(follower)), *changes)


def assess(crumple, folder, spaces, systems, draws, after_collision, estimator):
    """Runs an assessment in a folder, unless it has results."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in spaces.items():
        (folder / f"{name}.toml").write_text(text)
    here = CONFIG.parent
    systems = [str((here / name).resolve()) if name.endswith(".toml") else name for name in systems]
    config = tomllib.loads(CONFIG.read_text())
    config.update(controllers=systems, subject=systems[-1], estimator=estimator, draws=draws,
                  distributions=[f"{name}.toml" for name in spaces])
    config["harm"]["after_collision"] = after_collision
    lines = [f"{key} = {toml(value)}" for key, value in config.items()]
    (folder / "study.toml").write_text("\n".join(lines) + "\n")
    if not (folder / "report/runs.csv").is_file():
        command = [crumple, "assess", "study.toml", "--out", "report"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
        if done.returncode:
            sys.exit(f"error: {folder}: {done.stderr}")


def toml(value):
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {toml(one)}" for key, one in value.items()) + " }"
    return json.dumps(value, ensure_ascii=False)


def run_suite(crumple, folder):
    """Runs the suite `fmvss-127` with every system."""
    folder.mkdir(parents=True, exist_ok=True)
    command = [crumple, "suite", "run", "fmvss-127", "--format", "json"]
    for name in SYSTEMS + ADDED:
        command += ["--controller", str((CONFIG.parent / name).resolve()) if name.endswith(".toml") else name]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"error: {done.stderr}")
    (folder / "fmvss-127.json").write_text(done.stdout)


def systems(estimator):
    """Returns the systems of an assessment: with the true state, only those that a question names."""
    named = {name for question in QUESTIONS["questions"]
             for name in [question.get("before"), *question.get("after", [])]}
    return [name for name in SYSTEMS if estimator == "kalman" or name in named or name.startswith("human")]


def run(crumple, folder):
    """Runs the suite, and all assessments of the study."""
    run_suite(crumple, folder / "suite")
    draws = tomllib.loads(CONFIG.read_text())["draws"]
    for after_collision, estimator in CONDITIONS:
        name = f"{after_collision}-{estimator}"
        assess(crumple, folder / name, {"emergencies": SPACE.read_text()}, systems(estimator), draws, after_collision,
               estimator)
        if estimator == "kalman":
            assess(crumple, folder / f"{name}-added", {"emergencies": SPACE.read_text()}, ADDED, draws, after_collision,
                   estimator)
        spaces = {key: space_with_follower(key, follower) for key, follower in CONFORMING_SPACES.items()}
        assess(crumple, folder / f"{name}-conforming", spaces, [HUMAN, CONFORMING], draws, after_collision, estimator)
        print(name, flush=True)


def load(folder):
    """Returns {condition: {(space, system): Drives}}."""
    results = {}
    for after_collision, estimator in CONDITIONS:
        name = f"{after_collision}-{estimator}"
        parts = [name, f"{name}-conforming"] + ([f"{name}-added"] if estimator == "kalman" else [])
        results[after_collision, estimator] = {
            (space, short_name(system)): drives for part in parts
            for (space, system), drives in read(folder / part / "report/runs.csv").items()}
    return results


def short_name(system):
    """Returns the name of a system without the folder of its file."""
    return system.split("/")[-1].removesuffix(".toml")
