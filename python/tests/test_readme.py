"""Test of the code in the README."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(("page", "count"), [("python/README.md", 4), ("docs/optimisers.md", 1)])
def test_the_code_of_the_page_runs(tmp_path, monkeypatch, page, count):
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(), re.DOTALL)
    assert len(blocks) >= count
    names = {}
    for block in blocks:
        exec(compile(block, page, "exec"), names)
