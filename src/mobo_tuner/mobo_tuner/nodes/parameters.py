"""Parameters of the recorder, the console, the page and the live server."""

from mobo_tuner.parameter_spec import ParameterSpec

RECORDER = (
    ParameterSpec("bag_path", "", "Folder of the bag, which must not exist yet."),
    ParameterSpec(
        "discovery_period",
        0.2,
        "Time between two searches for new topics [s].",
        minimum=0.05,
        maximum=60.0,
    ),
)

CONSOLE = (
    ParameterSpec("run_id", "", "Id of the run; empty = the time."),
    ParameterSpec(
        "evaluations",
        0,
        "Budget of the run; 0 = the tuner's parameter.",
        minimum=0,
        maximum=100_000,
    ),
    ParameterSpec(
        "resume_from",
        "",
        "Id of the run to resume; empty = none.",
    ),
    ParameterSpec(
        "wait_for_recorder", True, "Whether to start the run only when a recorder records it."
    ),
    ParameterSpec(
        "ready_timeout",
        30.0,
        "Longest time to wait for the tuner and the recorder [s].",
        minimum=0.1,
        maximum=3600.0,
    ),
)

PAGE = (
    ParameterSpec(
        "host",
        "127.0.0.1",
        "Address to listen on; on any other than this host's own, only who has the token may act.",
    ),
    ParameterSpec("port", 8070, "Port to listen on; 0 = any free one.", minimum=0, maximum=65535),
    ParameterSpec("read_only", False, "Whether nobody may act."),
    ParameterSpec("runs_dir", "", "Folder of the runs that the page lists; empty = none."),
)

LIVE_SERVER = (
    ParameterSpec("host", "127.0.0.1", "Address to listen on."),
    ParameterSpec("port", 8765, "Port to listen on; 0 = any free one.", minimum=0, maximum=65535),
    ParameterSpec(
        "read_only",
        True,
        "Whether viewers may only look. The protocol has no password, and every site that a browser of this "
        "host visits can reach the server, too; false is allowed on this host's own addresses alone.",
    ),
)
