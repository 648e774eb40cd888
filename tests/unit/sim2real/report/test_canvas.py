"""Figures as SVG: where marks come to lie, and that a thinned line shows the same as the whole one."""

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from aerial_gym.sim2real.report.canvas import INCH, Panel, panels, ticks


def path_points(panel: Panel) -> list[np.ndarray]:
    result = re.findall(r' d="([^"]*)"', panel.svg(panel.x_values))
    return [np.array(re.sub("[Mh]", " ", path).split(), dtype=float) for path in result]


def test_a_line_lies_where_its_numbers_are() -> None:
    """Five per cent beside the ends: 0 and 10 come to lie at 1/22 and 21/22 of a panel, upright from the bottom."""
    panel = Panel(place=(100.0, 200.0, 2200.0, 1100.0))
    panel.line(np.array([0.0, 10.0]), np.array([-1.0, 1.0]), "#123456")
    np.testing.assert_array_equal(path_points(panel)[0], [200.0, 1250.0, 2200.0, 250.0])


def test_a_logarithmic_axis_has_equal_steps_for_equal_factors_and_bars_stand_on_its_frame() -> None:
    """1, 10 and 100 are equally far apart; zero, the foot of a bar, is the frame."""
    panel = Panel(place=(0.0, 0.0, 900.0, 1100.0), log=True, names=("a", "b", "c"))
    panel.bars(np.arange(3.0), np.array([1.0, 10.0, 100.0]), 0.8, "#123456")
    corners = path_points(panel)[0].reshape(3, 4, 2)
    np.testing.assert_array_equal(corners[:, 0, 1], 1100.0)
    np.testing.assert_array_equal(corners[:, 1, 1], [1050.0, 550.0, 50.0])


@pytest.mark.parametrize("rows", [100, 100_000])
def test_a_long_line_keeps_what_is_seen_of_it(rows: int) -> None:
    panel = Panel(place=(0.0, 0.0, 3000.0, 1000.0))
    time, values = np.arange(rows) / rows, np.random.default_rng(0).normal(size=rows)
    panel.line(time, values, "#123456")
    x, y = path_points(panel)[0].reshape(-1, 2).T
    assert x.size == (rows if rows < 300 else pytest.approx(2 * 3000 / 1.1 / 10, abs=4))
    assert np.all(np.diff(x) >= 0.0)
    assert (y.min(), y.max()) == (pytest.approx(45.0, abs=1.0), pytest.approx(955.0, abs=1.0))


def test_what_is_not_known_is_a_gap() -> None:
    panel, empty = Panel(place=(0.0, 0.0, 2200.0, 1100.0)), np.nan
    panel.line(np.arange(6.0), np.array([empty, 0.0, 1.0, empty, 0.0, 1.0]), "#123456")
    panel.error_bars(np.arange(3.0), np.array([0.0, empty, 0.0]), np.ones(3), "#123456")
    panel.line(np.arange(5.0), np.full(5, empty), "#123456")
    panel.dots(np.arange(5.0), np.full(5, empty), "#123456")
    assert [path.size // 2 for path in path_points(panel)[:3]] == [2, 2, 4]
    ElementTree.fromstring(f"<svg>{panel.svg(panel.x_values)}</svg>")


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (-0.1, 1.05, [0.0, 0.2, 0.4, 0.6, 0.8, 1.0]),
        (-7.3, 7.0, [-5.0, -2.5, 0.0, 2.5, 5.0]),
        (97.0, 103.0, range(97, 104)),
    ],
)
def test_numbers_of_an_axis_are_round(low: float, high: float, expected: list[float]) -> None:
    """Steps of 1, 2, 2.5 or 5 times a power of ten, within the axis."""
    np.testing.assert_allclose(ticks(low, high), list(expected), atol=1e-12)


def test_a_figure_is_well_formed_and_shared_axes_are_alike() -> None:
    figure, grid = panels(3, 2, width=2.0, height=1.0, title="a < b & c", sharex=True)
    grid[0][0].line(np.array([0.0, 1.0, np.nan]), np.array([1.0, 2.0, 3.0]), "#123456", label="<one>")
    grid[1][0].dots(np.array([0.0, 5.0]), np.array([1.0, 1.0]), "#123456")
    figure.legend = grid[0][0].marks
    tree = ElementTree.fromstring(figure.svg())
    words = [element.text for element in tree.iter("text")]
    assert {"a < b & c", "<one>"} <= set(words)
    assert len(list(tree.iter("rect"))) == 2
    marks = [path for path in tree.iter("path") if path.get("stroke-linejoin") or path.get("stroke-linecap")]
    line, dots = (path.get("d", "") for path in marks)
    assert "nan" not in line
    left, end = (float(re.findall(r"\d+", path)[at]) for path, at in ((line, 0), (line, 2)))
    start, last = (float(place) for place in re.findall(r"M(\d+)", dots))
    assert start == pytest.approx(left, abs=10.0)
    assert end - left == pytest.approx((last - start) / 5.0, abs=10.0)
    assert last - start == pytest.approx(2.0 * INCH / 1.1, abs=10.0)
