"""The parameters of the tuner's node, beside those of the problem."""

from mobo_tuner.parameter_spec import ParameterSpec

TUNER = (
    ParameterSpec(
        "preset",
        "default",
        "how candidates are chosen: the best recipe known, or the paper's to the letter",
        choices=("default", "paper"),
    ),
    ParameterSpec("seed", 0, "of every random choice of a run", minimum=0, maximum=2**31 - 1),
    ParameterSpec(
        "evaluations",
        60,
        "budget of a run whose goal names none; set while a run goes on, it is that run's budget",
        minimum=1,
        maximum=100_000,
        writable=True,
    ),
    ParameterSpec(
        "initial_evaluations",
        0,
        "points of the Latin-hypercube start; 0 = as many as the preset thinks fit",
        minimum=0,
        maximum=10_000,
    ),
    ParameterSpec(
        "proximal",
        False,
        "whether steps from one set-point to the next are kept short, weighed by the variables' cost",
    ),
    ParameterSpec(
        "model_input",
        "setpoint",
        "what the models learn from: where the machine was sent, or where its readbacks said it was",
        choices=("setpoint", "readback"),
    ),
    ParameterSpec(
        "shots",
        0,
        "shots to average over per evaluation; 0 = as many as the machine thinks fit",
        minimum=0,
        maximum=10_000,
    ),
    ParameterSpec(
        "runs_dir", "", "folder of the runs, where the journal is kept; empty = no journal"
    ),
    ParameterSpec(
        "discovery_timeout",
        10.0,
        "how long a goal waits for the machine to appear [s]",
        minimum=0.1,
        maximum=3600.0,
    ),
    ParameterSpec(
        "machine_timeout",
        5.0,
        "silence of the machine (no feedback, no result) after which it counts as lost [s]",
        minimum=0.5,
        maximum=3600.0,
    ),
    ParameterSpec(
        "suggestion_timeout",
        300.0,
        "longest time that one suggestion may take [s]",
        minimum=1.0,
        maximum=86_400.0,
    ),
    ParameterSpec(
        "evaluation_timeout",
        900.0,
        "longest time that one evaluation may take [s]",
        minimum=1.0,
        maximum=86_400.0,
    ),
    ParameterSpec(
        "max_consecutive_failures",
        10,
        "failed evaluations in a row after which the run ends with an error",
        minimum=1,
        maximum=100_000,
    ),
    ParameterSpec(
        "on_failure",
        "skip",
        "after a failed evaluation: try it again, learn from it and go on, or end the run",
        choices=("retry", "skip", "abort"),
    ),
    ParameterSpec(
        "max_attempts",
        3,
        "how often an evaluation is tried before it counts as failed, where on_failure is retry",
        minimum=1,
        maximum=1000,
    ),
    ParameterSpec(
        "retry_delay",
        1.0,
        "before the second attempt; it doubles with every further one, up to 60 s [s]",
        minimum=0.0,
        maximum=60.0,
    ),
    ParameterSpec(
        "machine_return_timeout",
        60.0,
        "how long a run pauses until a machine that was lost is back, before it ends with an error [s]",
        minimum=0.0,
        maximum=604_800.0,
    ),
    ParameterSpec(
        "on_abort",
        "hold",
        "where the tuner sends the machine after a cancel, a stop or an error",
        choices=("hold", "restore", "best"),
    ),
    ParameterSpec(
        "on_violation",
        "hold",
        "where the machine goes when a critical constraint is violated",
        choices=("hold", "restore", "best"),
    ),
    ParameterSpec(
        "on_client_lost",
        "hold",
        "where the machine goes when the tuner's heartbeat stops",
        choices=("hold", "restore", "best"),
    ),
    ParameterSpec(
        "pause_on_violation",
        False,
        "whether a run pauses, until someone says resume or step, after a violation",
    ),
    ParameterSpec(
        "client_timeout",
        5.0,
        "silence of the tuner's heartbeat after which the machine counts it as lost; "
        "0 = it does not watch [s]",
        minimum=0.0,
        maximum=3600.0,
    ),
)
