"""Topics and services of the simulated machine, beside those that every machine has."""

from __future__ import annotations

from rclpy.qos import qos_profile_system_default
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Bool, Float64
from std_srvs.srv import Trigger

from mobo_msgs_py.msg import NamedValues
from mobo_tuner.ros.interfaces import Service, Topic
from mobo_tuner.ros.qos import LATCHED, STREAM

NODE = "awa_sim"

SETPOINT = Topic(
    "<device>/setpoint", Float64, STREAM, "clients", "Set-point of one device, which then moves."
)
READBACK = Topic(
    "<device>/readback", Float64, STREAM, NODE, "Readback of one device, at `stream_rate`."
)
SETTLED = Topic(
    "<device>/settled", Bool, LATCHED, NODE, "Whether the device rests there, after each change."
)
BEAM = Topic(
    "beam/<diagnostic>",
    Float64,
    STREAM,
    NODE,
    "Diagnostic of one shot; NaN = not measured.",
)
INTERLOCK = Topic(
    "interlock", Bool, LATCHED, NODE, "Whether an interlock prevents moves, after each change."
)
MODEL_UNCERTAINTY = Topic(
    "model_uncertainty",
    NamedValues,
    LATCHED,
    NODE,
    "Standard deviation of the machine's model at the last measurement.",
)
TRUTH = Topic(
    "truth",
    NamedValues,
    STREAM,
    NODE,
    "True values of every shot, for tests; only with `publish_truth`.",
)
CLOCK = Topic(
    "/clock",
    Clock,
    qos_profile_system_default,
    NODE,
    "Simulated time; only with `publish_clock`.",
)
STOP = Service("stop", Trigger, NODE, "Stops the current move; the machine holds its position.")
CLEAR_INTERLOCK = Service("clear_interlock", Trigger, NODE, "Clears the interlock.")

TOPICS = tuple(item for item in list(globals().values()) if isinstance(item, Topic))
SERVICES = tuple(item for item in list(globals().values()) if isinstance(item, Service))
