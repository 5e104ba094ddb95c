"""Tests of figures, images of episodes, and tables."""

import csv
import struct
import sys
import xml.etree.ElementTree as ElementTree

import gymnasium
import numpy as np
import pytest

import crumple


def test_failures_and_runs_are_drawn(tmp_path):
    found = crumple.falsify("match-leader", budget=60)
    figure = found.failures[0].plot()
    ElementTree.fromstring(figure.svg.encode())
    assert figure._repr_svg_() == figure.svg
    figure.save(tmp_path / "run.svg")
    assert (tmp_path / "run.svg").read_text() == figure.svg
    run = found.failures[0].replay()
    assert run.plot().svg == figure.svg
    assert run.plot("stacked").svg != figure.svg
    with pytest.raises(ValueError, match="layout"):
        run.plot("round")
    with pytest.raises(ValueError, match=r"saved as \.svg, \.pdf or \.png"):
        figure.save(tmp_path / "run.jpg")
    with pytest.raises(crumple.RunError, match="trace=True"):
        crumple.simulate("paper-1", trace=False).plot()


def test_a_figure_is_saved_as_pdf_and_png(tmp_path):
    pytest.importorskip("vl_convert")
    figure = crumple.simulate("paper-1").plot()
    for name, magic in (("run.pdf", b"%PDF-"), ("run.png", b"\x89PNG\r\n")):
        figure.save(tmp_path / name)
        assert (tmp_path / name).read_bytes().startswith(magic)
    # A PNG has two pixels per unit: width and height follow the chunk's name.
    root = ElementTree.fromstring(figure.svg.encode())
    pixels = struct.unpack(">II", (tmp_path / "run.png").read_bytes()[16:24])
    assert pixels == tuple(round(2 * float(root.get(side))) for side in ("width", "height"))
    with pytest.raises(ValueError, match="cannot be converted"):
        crumple.Figure("no figure").save(tmp_path / "bad.pdf")
    assert not (tmp_path / "bad.pdf").exists()


def test_a_missing_converter_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "vl_convert", None)
    with pytest.raises(ImportError, match=r"pip install .crumple\[figures\]"):
        crumple.simulate("paper-1").plot().save(tmp_path / "run.pdf")


def test_a_figure_equals_that_of_the_command_line(tmp_path, command_line_json):
    command_line_json("simulate", "paper-1", "--plot", tmp_path / "run.svg")
    assert crumple.simulate("paper-1").plot().svg == (tmp_path / "run.svg").read_text()


def test_an_episode_is_drawn_from_above_and_over_time():
    env = gymnasium.make("crumple/Platoon-v0", space="high-risk", render_mode="rgb_array")
    env.reset(seed=0)
    first = env.render()
    assert (first.dtype, first.ndim, first.shape[2]) == (np.uint8, 3, 3)
    for _ in range(20):
        env.step(np.zeros(1, np.float32))
    later = env.render()
    assert later.shape == first.shape
    # The agent's orange vehicle is fixed in the upper image; its trajectory grows in the lower one.
    orange = [(picture == (213, 94, 0)).all(axis=2) for picture in (first, later)]
    assert np.array_equal(orange[0][:96], orange[1][:96])
    assert orange[1][96:].sum() > 3 * orange[0][96:].sum() > 0
    env.reset(seed=0)
    assert np.array_equal(env.render(), first)
    assert gymnasium.make("crumple/Platoon-v0").unwrapped.render() is None


def test_traces_convert_to_tables_of_arrow_libraries(tmp_path, command_line_json):
    pyarrow, polars, pandas = (pytest.importorskip(name) for name in ("pyarrow", "polars", "pandas"))
    run = crumple.simulate("paper-1")
    table = pyarrow.table(run.trace)
    assert table.column_names == ["time_s", "vehicle", "position_m", "speed_mps", "acceleration_mps2", "gap_m"]
    assert table.num_rows == 3 * len(run.trace)
    for index, track in enumerate(run.trace.vehicles):
        rows = table.filter(pyarrow.compute.equal(table["vehicle"], index))
        assert np.array_equal(rows["time_s"], run.trace.time_s)
        for name in ("position_m", "speed_mps", "acceleration_mps2"):
            assert np.array_equal(rows[name], getattr(track, name))
        assert rows["gap_m"].null_count == (len(rows) if index == 0 else 0)
    command_line_json("simulate", "paper-1", "--trace", tmp_path / "trace.csv")
    with (tmp_path / "trace.csv").open() as file:
        rows = [{name: float(text) if text else None for name, text in row.items()} for row in csv.DictReader(file)]
    assert table.to_pylist() == rows
    assert isinstance(table.to_pandas(), pandas.DataFrame)
    frame = polars.DataFrame(run.trace)
    assert frame.equals(polars.from_arrow(table))
    again = frame.group_by("vehicle").agg(polars.col("gap_m").min()).sort("vehicle")
    assert again["gap_m"][0] is None
    # An unused capsule is freed, and each call returns a new one.
    assert run.trace.__arrow_c_stream__() is not None
    gap_m = run.trace.vehicles[0].position_m
    gap_m[0] += 1.0
    assert pyarrow.table(run.trace)["position_m"][0].as_py() == gap_m[0]
