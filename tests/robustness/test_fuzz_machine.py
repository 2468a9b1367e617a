"""The machine survives random and malformed goals, set-points, parameters and transitions."""

from __future__ import annotations

import os

from robustness.fuzz_machine import PARAMETERS, Fuzzer
from robustness.machine_process import MachineProcess


def test_what_is_malformed_is_refused_with_the_right_error(ros_domain: int) -> None:
    del ros_domain  # has set the environment
    with MachineProcess(os.environ, PARAMETERS) as machine:
        report = Fuzzer(machine, seed=7).run(400)
        assert machine.alive
    assert report.wrong == []
    assert report.total >= 400
    assert len(report.sent) >= 25
