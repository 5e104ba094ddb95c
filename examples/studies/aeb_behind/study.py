"""Configuration of the study, and its runs."""

import hashlib
import itertools
import json
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path

from drives import read

HERE = Path(__file__).resolve().parent
SPACE = HERE.parent / "emergencies.toml"
WITHIN_THE_TESTS = HERE / "within-the-tests.toml"
CONFIG = HERE.parent / "aeb-behind.toml"
QUESTIONS = tomllib.loads((HERE / "questions.toml").read_text())
SYSTEMS = tomllib.loads(CONFIG.read_text())["controllers"]
SEED = tomllib.loads(CONFIG.read_text())["seed"]
# Seed of the second run, chosen and committed before it.
SEED_OF_REPETITION = 20261130
# Drivers of crumple that observe the vehicle behind. They were added after the first run: no question names them.
ADDED = ["predictive", "road"]
NONE, BRAKE, HUMAN, ASSISTED, CONFORMING = ("emergency-brake,ttc_s=0", "emergency-brake,ttc_s=2", "human",
                                            "human,aeb_ttc_s=1.4", "human,aeb_ttc_s=2")
CONDITIONS = list(itertools.product(QUESTIONS["assumptions"]["after_collision"], QUESTIONS["assumptions"]["estimator"]))
# Emergencies within speeds and braking of the tests: all cars behind have the brake, or none.
SPACES_WITHIN_THE_TESTS = ["within-the-tests", "within-the-tests-alone"]
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


def claim(crumple, folder):
    """Records the program of a folder, and refuses a folder with results of another one."""
    folder.mkdir(parents=True, exist_ok=True)
    record, program = folder / "program.sha256", hashlib.sha256(crumple.read_bytes()).hexdigest()
    if not record.is_file() and any(folder.iterdir()):
        sys.exit(f"error: {folder} has files, but no {record.name}: use an empty folder")
    if record.is_file() and record.read_text() != program:
        sys.exit(f"error: {folder} has results of another program: use an empty folder")
    record.write_text(program)


@dataclass(frozen=True)
class Assessment:
    """One assessment of the study, in a folder with its inputs and its results. `spaces` is {name: text}."""

    name: str
    spaces: dict
    systems: list
    draws: int
    after_collision: str
    estimator: str
    seed: int = SEED

    def inputs(self):
        """Returns {name: text} of all files that it reads."""
        texts = {f"{name}.toml": text for name, text in self.spaces.items()}
        texts |= {Path(name).name: (CONFIG.parent / name).read_text() for name in self.systems
                  if name.endswith(".toml")}
        systems = [Path(name).name if name.endswith(".toml") else name for name in self.systems]
        config = tomllib.loads(CONFIG.read_text())
        config.update(controllers=systems, subject=systems[-1], estimator=self.estimator, draws=self.draws,
                      seed=self.seed, distributions=[f"{name}.toml" for name in self.spaces])
        config["harm"]["after_collision"] = self.after_collision
        lines = [f"{key} = {toml(value)}" for key, value in config.items()]
        return texts | {"study.toml": "\n".join(lines) + "\n"}

    def run(self, crumple, runs):
        """Runs it in a folder below `runs`. crumple itself reuses only evidence of the same program and inputs."""
        folder = runs / self.name
        folder.mkdir(parents=True, exist_ok=True)
        # An interrupted run leaves no results beside inputs that they do not belong to.
        (folder / "report/runs.csv").unlink(missing_ok=True)
        for name, text in self.inputs().items():
            (folder / name).write_text(text)
        command = [crumple, "assess", "study.toml", "--out", "report"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
        if done.returncode:
            sys.exit(f"error: {folder}: {done.stderr}")

    def read(self, runs):
        """Returns {(space, system): Drives}, and refuses results of other inputs."""
        folder = runs / self.name
        for name, text in self.inputs().items():
            if not (folder / name).is_file() or (folder / name).read_text() != text:
                sys.exit(f"error: {folder} has no results of today's {name}: run it again")
        if not (folder / "report/runs.csv").is_file():
            sys.exit(f"error: {folder} has no results: run it again")
        return {(space, short_name(system)): drives
                for (space, system), drives in read(folder / "report/runs.csv").items()}


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


def assessments(after_collision, estimator, seed=SEED):
    """Returns the assessments of one condition."""
    draws, condition = tomllib.loads(CONFIG.read_text())["draws"], f"{after_collision}-{estimator}"
    emergencies = {"emergencies": SPACE.read_text()}
    conforming = {name: space_with_follower(name, follower) for name, follower in CONFORMING_SPACES.items()}
    all_brake, alone = SPACES_WITHIN_THE_TESTS
    text = WITHIN_THE_TESTS.read_text()
    within = {all_brake: text, alone: replaced(
        text, (f'name = "{all_brake}"\nabout = """', f'name = "{alone}"\nabout = """'),
        ("driver.human = { aeb_ttc_s = 2 }", 'driver = "human"'))}
    parts = [("", emergencies, systems(estimator)), ("-conforming", conforming, [HUMAN, CONFORMING]),
             ("-within-the-tests", within, [HUMAN, CONFORMING])]
    if estimator == "kalman":
        parts.append(("-added", emergencies, ADDED))
    return [Assessment(condition + ending, spaces, of, draws, after_collision, estimator, seed)
            for ending, spaces, of in parts]


def run(crumple, folder):
    """Runs the suite, and all assessments of both runs of the study."""
    claim(crumple, folder)
    run_suite(crumple, folder / "suite")
    run_assessments(crumple, folder, SEED)
    run_assessments(crumple, folder / "repeated", SEED_OF_REPETITION)


def run_assessments(crumple, folder, seed):
    for condition in CONDITIONS:
        for assessment in assessments(*condition, seed):
            assessment.run(crumple, folder)
            print(assessment.name, flush=True)


def load(folder, seed=SEED):
    """Returns {condition: {(space, system): Drives}}."""
    return {condition: {key: drives for assessment in assessments(*condition, seed)
                        for key, drives in assessment.read(folder).items()}
            for condition in CONDITIONS}


def short_name(system):
    """Returns the name of a system without the folder of its file."""
    return system.split("/")[-1].removesuffix(".toml")
