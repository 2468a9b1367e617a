"""Whether the time on `/clock` stands still."""

from __future__ import annotations

from awa_sim_node.external_clock import PATIENCE, ExternalClock


def test_a_clock_that_stands_still_is_said_and_one_that_goes_on_is_not() -> None:
    simulated, wall = 0.0, 100.0
    clock = ExternalClock(lambda: simulated, lambda: wall)
    assert (clock(), clock.trouble) == (0.0, "")  # it may only just have been started
    wall += 2.0 * PATIENCE
    assert "use_sim_time is true, and nobody publishes /clock" in clock.trouble
    for simulated in (1.6e9, 5.0):  # also one that jumps back goes on
        assert (clock(), clock.trouble) == (simulated, "")
        wall += 0.9 * PATIENCE
        assert clock.trouble == ""
    wall += PATIENCE
    assert "stands at 5 s" in clock.trouble
