"""What several tests need."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture
def command_line():
    """The program, where it was built."""
    known = [os.environ.get("CRUMPLE"), ROOT / "target/release/crumple", ROOT / "target/debug/crumple"]
    built = next((str(path) for path in known if path and Path(path).exists()), None) or shutil.which("crumple")
    return built or pytest.skip("no program `crumple` was built")


@pytest.fixture
def told_by_command_line(command_line):
    """What the program prints as JSON."""

    def told(*arguments):
        arguments = [command_line, *map(str, arguments), "--format", "json", "--quiet"]
        return json.loads(subprocess.run(arguments, check=True, capture_output=True, text=True).stdout)

    return told
