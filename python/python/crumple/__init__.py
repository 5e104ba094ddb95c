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
    allow_external,
    training_preset,
)
from crumple._evidence import Rate, WorstCase, assess, rate, worst_case, write_report
from crumple._monitor import monitor
from crumple._registration import register_environments
from crumple._search import SearchMethod
from crumple._serve import serve
from crumple._simulate import scenario, simulate, space
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
    "Failure",
    "Figure",
    "FormulaError",
    "Observation",
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
    "TrainingError",
    "WorstCase",
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
    "training_preset",
    "worst_case",
    "write_report",
]

register_environments()
