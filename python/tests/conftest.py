"""Fixtures of several tests."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture
def crumple_binary():
    """Returns the path of the program, if it was built."""
    known = [os.environ.get("CRUMPLE"), ROOT / "target/release/crumple", ROOT / "target/debug/crumple"]
    built = next((str(path) for path in known if path and Path(path).exists()), None) or shutil.which("crumple")
    return built or pytest.skip("no program `crumple` was built")


@pytest.fixture
def command_line_json(crumple_binary):
    """Returns a function that runs the program and returns its JSON output."""

    def run(*arguments):
        arguments = [crumple_binary, *map(str, arguments), "--format", "json", "--quiet"]
        return json.loads(subprocess.run(arguments, check=True, capture_output=True, text=True).stdout)

    return run


@pytest.fixture
def command_line_text(crumple_binary):
    """Returns a function that runs the program and returns its text."""

    def run(*arguments):
        arguments = [crumple_binary, *map(str, arguments), "--quiet"]
        return subprocess.run(arguments, check=True, capture_output=True, text=True).stdout

    return run
