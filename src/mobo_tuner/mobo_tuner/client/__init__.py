"""The tuner from a plain Python program: `TunerClient`, and the plain values that it gives."""

from mobo_tuner.client.tuner_client import TunerClient
from mobo_tuner.client.values import (
    Arrival,
    ErrorCode,
    Evaluation,
    Front,
    Movement,
    Point,
    RunResult,
    Status,
    Suggestion,
    TunerError,
    WorkingPoints,
)

__all__ = [
    "Arrival",
    "ErrorCode",
    "Evaluation",
    "Front",
    "Movement",
    "Point",
    "RunResult",
    "Status",
    "Suggestion",
    "TunerClient",
    "TunerError",
    "WorkingPoints",
]
