"""Simulation, falsification, verification and training of longitudinal driving controllers."""

from crumple._campaign import Campaign, Comparison, Failure, compare, falsify
from crumple._controller import OBSERVATION, Controller
from crumple._crumple import (
    Assessment,
    Figure,
    Observation,
    Scenario,
    Simulation,
    Space,
    Trace,
    Track,
    __version__,
    allow_external,
    training_preset,
)
from crumple._evidence import PooledRate, Rate, WorstCase, assess, rate, worst_case, write_report
from crumple._executor import Executor
from crumple._monitor import monitor
from crumple._registration import register_environments
from crumple._search import SearchMethod
from crumple._serve import serve
from crumple._simulate import scenario, simulate, space
from crumple._train import Training, train
from crumple.errors import (
    AssessmentError,
    CampaignError,
    ControllerError,
    CrumpleError,
    FormulaError,
    RateError,
    RunError,
    ScenarioError,
    SpaceError,
    TrainingError,
    WorkerError,
)

__all__ = [
    "OBSERVATION",
    "Assessment",
    "AssessmentError",
    "Campaign",
    "CampaignError",
    "Comparison",
    "Controller",
    "ControllerError",
    "CrumpleError",
    "Executor",
    "Failure",
    "Figure",
    "FormulaError",
    "Observation",
    "PooledRate",
    "Rate",
    "RateError",
    "RunError",
    "Scenario",
    "ScenarioError",
    "SearchMethod",
    "Simulation",
    "Space",
    "SpaceError",
    "Trace",
    "Track",
    "Training",
    "TrainingError",
    "WorkerError",
    "WorstCase",
    "__version__",
    "allow_external",
    "assess",
    "compare",
    "falsify",
    "monitor",
    "rate",
    "scenario",
    "serve",
    "simulate",
    "space",
    "train",
    "training_preset",
    "worst_case",
    "write_report",
]

register_environments()
