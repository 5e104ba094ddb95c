"""crumple crash-tests longitudinal driving controllers before the road does."""

from crumple._campaign import Campaign, Failure, falsify
from crumple._controller import OBSERVATION, Controller
from crumple._crumple import Observation, Scenario, Simulation, Space, Trace, Track
from crumple._registration import register_environments
from crumple._simulate import scenario, simulate, space
from crumple.errors import (
    CampaignError,
    ControllerError,
    CrumpleError,
    RunError,
    ScenarioError,
    SpaceError,
    TrainingError,
)

__all__ = [
    "OBSERVATION",
    "Campaign",
    "CampaignError",
    "Controller",
    "ControllerError",
    "CrumpleError",
    "Failure",
    "Observation",
    "RunError",
    "Scenario",
    "ScenarioError",
    "Simulation",
    "Space",
    "SpaceError",
    "Trace",
    "Track",
    "TrainingError",
    "falsify",
    "scenario",
    "simulate",
    "space",
]

register_environments()
