"""The parameters of a campaign, a section of a parameter file."""

from __future__ import annotations

from mobo_tuner.parameter_spec import ParameterSpec

CAMPAIGN = (
    ParameterSpec(
        "command",
        "",
        "Command of the simulation, which reads a point as a JSON object on standard input and prints its "
        "outputs as one; the files that it names are beside the parameter file. Empty if a function simulates, or "
        "machines are the workers.",
    ),
    ParameterSpec(
        "function",
        "",
        "Python function that simulates a point in place of a command, FILE.py:FUNCTION or PACKAGE:FUNCTION: from a "
        "mapping of variables to one of outputs. A file is beside the parameter file.",
    ),
    ParameterSpec(
        "timeout", 3600.0, "Longest time of one simulation [s].", minimum=0.1, maximum=31_536_000.0
    ),
    ParameterSpec(
        "workers", 2, "Number of simulations at the same time.", minimum=1, maximum=10_000
    ),
)
"""Parameters of the section `campaign` of a parameter file."""
