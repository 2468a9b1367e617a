"""The package by itself, for `colcon test`; the whole test suite is in tests/ of the repository."""

import math

import pytest

from awa_sim_node.machine import SimulatedMachine, describe


@pytest.mark.parametrize("model", ["awa", "toy"])
def test_a_machine_reads_back_where_it_starts(model: str) -> None:
    machine = SimulatedMachine(model, "ideal", 0)
    readbacks = machine.readbacks()
    assert [*readbacks] == [v.name for v in describe(model).variables]
    assert all(math.isfinite(value) for value in readbacks.values())


def test_the_node_can_be_imported() -> None:
    from awa_sim_node.node import main

    assert callable(main)
