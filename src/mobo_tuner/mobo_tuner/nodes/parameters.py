"""The parameters of the other nodes."""

from mobo_tuner.parameter_spec import ParameterSpec

RECORDER = (
    ParameterSpec("bag_path", "", "folder of the bag; must not exist yet"),
    ParameterSpec(
        "discovery_period",
        0.2,
        "how often new topics are looked for [s]",
        minimum=0.05,
        maximum=60.0,
    ),
)

CONSOLE = (
    ParameterSpec("run_id", "", "names the run; empty = the time gives the name"),
    ParameterSpec(
        "evaluations", 0, "budget of the run; 0 = as the tuner is set", minimum=0, maximum=100_000
    ),
    ParameterSpec(
        "resume_from",
        "",
        "id of an earlier run whose evaluations this one begins with; empty = none",
    ),
    ParameterSpec("wait_for_recorder", True, "begin only when a recorder records the run"),
    ParameterSpec(
        "ready_timeout",
        30.0,
        "how long to wait for the tuner and the recorder [s]",
        minimum=0.1,
        maximum=3600.0,
    ),
)
