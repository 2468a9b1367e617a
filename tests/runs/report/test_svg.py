"""Plots as SVG: well-formed, escaped, and with every point where it belongs."""

from __future__ import annotations

import math
import re
from xml.etree import ElementTree

import numpy as np
import pytest

from mobo_tuner.runs.report.svg import Axis, ParallelAxes, Plot, render_legend

SVG = "{*}"


def paths(plot: Plot, css: str) -> list[str]:
    """The paths of one style."""
    root = ElementTree.fromstring(plot.render())
    return [p.get("d", "") for p in root.iter("path") if css in p.get("class", "").split()]


def test_points_lie_between_the_corners_of_the_plot() -> None:
    plot = Plot(Axis(0.0, 4.0), Axis(-1.0, 1.0), size=(330, 220))
    plot.marks([0.0, 4.0, 2.0], [-1.0, 1.0, 0.0], "k-a")
    (path,) = paths(plot, "k-a")
    low, high, middle = ([float(v) for v in p.split("h")[0].split()] for p in path[1:].split("M"))
    assert low[0] < middle[0] < high[0]
    assert low[1] > middle[1] > high[1], "the vertical axis points upwards"
    np.testing.assert_allclose(middle, np.add(low, high) / 2.0, atol=0.11)
    assert low[0] >= 0.0
    assert high[0] <= 330.0


def test_what_is_not_finite_is_left_out_and_what_is_outside_is_counted() -> None:
    plot = Plot(Axis(0.0, 1.0), Axis(0.0, 1.0))
    plot.marks([0.5, math.nan, 9.0, 0.2], [0.5, 0.5, 0.5, math.inf], "k-a")
    plot.line([0.0, 0.3, math.nan, 0.7, 1.0], np.full(5, 0.5), "k-b")
    (marks,) = paths(plot, "k-a")
    assert marks.count("M") == 1
    (line,) = paths(plot, "k-b")
    assert (line.count("M"), line.count("L")) == (2, 2)
    assert "1 outside" in plot.render()


def test_steps_hold_a_value_until_the_next_one() -> None:
    plot = Plot(Axis(0.0, 2.0), Axis(0.0, 2.0))
    plot.line([0.0, 1.0, 2.0], [0.0, 1.0, 2.0], "k-a", step=True)
    (path,) = paths(plot, "k-a")
    corners = [tuple(map(float, corner.split())) for corner in re.split("[ML]", path)[1:]]
    assert len(corners) == 5
    assert corners[0][1] == corners[1][1]
    assert corners[1][0] == corners[2][0]
    plot.line([1.0], [1.0], "k-b", step=True)
    assert [path.count("L") for path in paths(plot, "k-b")] == [1]  # a value alone is seen, too


@pytest.mark.parametrize(
    ("low", "high", "texts", "power"),
    [
        (0.0, 1.0, ["0", "0.2", "0.4", "0.6", "0.8", "1.0"], ""),
        (-4.1, 4.1, ["−4", "−2", "0", "2", "4"], ""),
        (0.0, 3.1e8, ["0", "1", "2", "3"], "×10⁸"),
        (0.0, 2.4e-5, ["0", "0.5", "1.0", "1.5", "2.0"], "×10⁻⁵"),
        (1000.0, 1000.4, ["1000.0", "1000.1", "1000.2", "1000.3", "1000.4"], ""),
    ],
)
def test_ticks_are_round_numbers(low: float, high: float, texts: list[str], power: str) -> None:
    ticks, shared = Axis(low, high).ticks(5)
    assert ([text for _, text in ticks], shared) == (texts, power)
    assert all(low <= value <= high + 1e-9 * abs(high) for value, _ in ticks)


def test_an_axis_of_indices_has_integers_only() -> None:
    ticks, _ = Axis(-0.5, 1.5, integer=True).ticks(8)
    assert [text for _, text in ticks] == ["0", "1"]


def test_an_axis_shows_everything_also_a_single_value_or_none() -> None:
    assert Axis.around([1.0, math.nan, 3.0], margin=0.5) == Axis(0.0, 4.0)
    one = Axis.around([5.0])
    assert one.low < 5.0 < one.high
    assert Axis.around([0.0]).low < 0.0
    assert Axis.around([]) == Axis(0.0, 1.0)


@pytest.mark.parametrize("high", [math.inf, 1.7e308])
def test_an_axis_of_the_largest_numbers_has_finite_ticks(high: float) -> None:
    for axis in (Axis(-high, high), Axis.around([-1.7e308, 1.7e308, high])):
        assert all(math.isfinite(value) for value, _ in axis.ticks(5)[0])


def test_every_text_is_escaped() -> None:
    evil = "<script>alert('x')</script>\"&"
    plot = Plot(Axis(0.0, 1.0, evil), Axis(0.0, 1.0, evil), evil)
    plot.marks([0.5], [0.5], "k-a", evil, titles=[evil])
    parallel = ParallelAxes([Axis(0.0, 1.0, evil), Axis(0.0, 2.0, "b [mm]")])
    parallel.lines(np.array([[0.5, 0.5]]), "k-a", [evil])
    for text in (plot.render(), parallel.render(), render_legend([plot])):
        assert "<script" not in text
        ElementTree.fromstring(text)
    titles = [t.text for t in ElementTree.fromstring(plot.render()).iter("title")]
    assert titles == [evil]


def test_several_plots_share_one_legend() -> None:
    plots = [Plot(Axis(0.0, 1.0), Axis(0.0, 1.0)) for _ in range(3)]
    for plot in plots:
        plot.marks([0.5], [0.5], "k-a", "feasible")
    assert render_legend(plots).count("feasible") == 1


def test_parallel_lines_end_at_their_axes_and_break_where_nothing_was_measured() -> None:
    parallel = ParallelAxes([Axis(0.0, 1.0, "a"), Axis(0.0, 1.0, "b"), Axis(0.0, 1.0, "c")])
    parallel.lines(np.array([[0.0, 7.0, 1.0], [0.5, math.nan, 0.5]]), "k-a", ["one", "two"])
    root = ElementTree.fromstring(parallel.render())
    whole, broken = (p.get("d", "") for p in root.iter("path") if "k-a" in p.get("class", ""))
    heights = [float(corner.split()[1]) for corner in re.split("[ML]", whole)[1:]]
    assert heights[0] > heights[1] == heights[2], "what is above the axis is at its upper end"
    assert broken.count("L") == 0


@pytest.mark.parametrize(
    ("low", "high", "texts"),
    [
        (1.0, 100.0, ["1", "3", "10", "30", "100"]),
        (0.05, 0.6, ["0.05", "0.1", "0.2", "0.5"]),
        (1e-9, 1e9, ["10⁻⁹", "10⁻⁵", "0.1", "1000", "10⁷"]),
    ],
)
def test_a_logarithmic_axis_has_ticks_at_powers_of_ten(
    low: float, high: float, texts: list[str]
) -> None:
    ticks, power = Axis(low, high, log=True).ticks(5)
    assert ([text for _, text in ticks], power) == (texts, "")


def test_equal_ratios_are_equally_far_apart_on_a_logarithmic_axis() -> None:
    axis = Axis.around([0.0, 1.0, math.nan, 10000.0], margin=0.0, log=True)
    assert (axis.low, axis.high) == pytest.approx((1.0, 10000.0))
    plot = Plot(Axis(0.0, 4.0), axis, size=(330, 220))
    plot.line([0.0, 2.0, 3.0, 4.0], [1.0, 100.0, -1.0, 10000.0], "k-a")
    (path,) = re.findall(r' d="(M[^"]*)"/></svg>', plot.render())
    heights = [float(place.split()[1]) for place in re.split("[ML]", path)[1:]]
    assert heights[0] - heights[1] == pytest.approx(heights[1] - heights[2], abs=0.2)
