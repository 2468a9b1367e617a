"""The points of the data set."""

from __future__ import annotations

from dataclasses import astuple, fields

import numpy as np
import pytest
from scipy.stats import qmc

from awa_sim_node.simulation.injector import Settings
from awa_sim_node.simulation.samples import CORNER, ROWS, sample
from awa_sim_node.surrogate.metadata import INPUTS

LOW, HIGH = np.array([quantity.training_range for quantity in INPUTS]).T
SAMPLES = [sample(number) for number in range(ROWS)]
POINTS = np.array([astuple(point.settings) for point in SAMPLES])
IN_CORNER = np.array([point.region == "corner" for point in SAMPLES])


def test_the_settings_are_the_surrogates_inputs_in_their_order() -> None:
    assert [field.name for field in fields(Settings)] == [quantity.name for quantity in INPUTS]


def test_seven_of_ten_fill_the_box_and_three_the_corner() -> None:
    assert ROWS >= 2000
    assert IN_CORNER.mean() == pytest.approx(0.3)
    assert {point.region for point in SAMPLES} == {"space", "corner"}
    assert [point.number for point in SAMPLES] == list(range(ROWS))
    assert np.all((POINTS >= LOW) & (POINTS <= HIGH))
    for name, (low, high) in CORNER.items():
        values = POINTS[IN_CORNER, [quantity.name for quantity in INPUTS].index(name)]
        assert low <= values.min() < low + 0.01 * (high - low)
        assert high - 0.01 * (high - low) < values.max() <= high


def test_they_fill_the_box_evenly() -> None:
    # Far better than random points, whose discrepancy is some 5e-3.
    scaled = (POINTS[~IN_CORNER] - LOW) / (HIGH - LOW)
    assert qmc.discrepancy(scaled) < 1e-3
    assert len(np.unique(POINTS, axis=0)) == ROWS


def test_the_first_are_those_of_the_prototype() -> None:
    expected = (
        450.82349,
        229.07055,
        -4.2969302,
        -7.5509703,
        60.643386,
        17.565301,
        44.468988,
        0.35329152,
    )
    np.testing.assert_allclose(POINTS[0], expected, rtol=1e-5)


def test_a_table_holds_the_settings_exactly() -> None:
    for point in SAMPLES[:100]:
        assert all(float(f"{value:.10g}") == value for value in astuple(point.settings))


@pytest.mark.parametrize("number", [-1, 11702, 10**6])
def test_there_are_so_many(number: int) -> None:
    assert sample(11701).region == "space"
    with pytest.raises(ValueError, match=f"^sample = {number} must be from 0 to 11701$"):
        sample(number)
