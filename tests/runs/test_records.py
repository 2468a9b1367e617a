"""The records of a run: JSON and messages are two views of the same record."""

from __future__ import annotations

import json
import math
from dataclasses import fields, replace

import pytest
from builtin_interfaces.msg import Time
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from std_msgs.msg import Header

from mobo_msgs_py import msg
from mobo_msgs_py.action import EvaluateSetpoint
from mobo_tuner.client.values import problem_of
from mobo_tuner.core import Problem
from mobo_tuner.runs import history
from mobo_tuner.runs.definitions import find_definition
from mobo_tuner.runs.journal import journal_line
from mobo_tuner.runs.records import (
    SOURCES,
    ChangeRecord,
    EndRecord,
    EvaluationRecord,
    ForgetRecord,
    MessageClasses,
    MoveRecord,
    QueuedRecord,
    Record,
    StartRecord,
    StateRecord,
    from_json,
    from_message,
    problem_from_message,
    to_json,
    to_message,
)
from mobo_tuner.tuner.messages import problem_message

# The parser that ROS's type support imports does so.
pytestmark = pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning")

PROBLEM = Problem.from_dict(
    {
        "variables": {"K1": {"min": 0.0, "max": 9.0, "unit": "A"}},
        "objectives": {
            "f": {"reference": 2.0, "unit": "mm"},
            "g": {"reference": 1.0, "direction": "maximize"},
        },
    }
)
EVALUATION = EvaluationRecord(
    index=70_000,
    source="operator",
    attempts=2,
    stamp=1_700_000_000.25,
    setpoint={"K1": 3.5},
    readbacks={"K1": math.nan},
    diagnostics={"f": (1.5, 0.1), "charge": (40.0, math.nan)},
    valid=True,
    feasible=False,
    non_dominated=True,
    hypervolume=0.75,
    hypervolume_measured=0.5,
    error_code=5,
    error_msg="the camera saw nothing",
    suggest_seconds=0.5,
    machine_seconds=1.5,
    total_seconds=2.5,
)
CLASSES = MessageClasses(msg.Evaluation, msg.NamedValue, Header, Time)


def same(one: Record, other: Record) -> bool:
    """Whether two records are equal, NaN being equal to itself."""
    return repr(one) == repr(other)


@pytest.mark.parametrize(
    "record",
    [
        StartRecord("run", 1.0, PROBLEM, {"seed": 3, "model_input": "setpoint"}),
        StartRecord("run", 1.0, PROBLEM, {}, {"run_id": "before", "evaluations": 7}),
        EVALUATION,
        ChangeRecord(2.0, 7, PROBLEM, 80),
        ForgetRecord(2.5, 7, 3, "f", withdrawn=False),
        MoveRecord(3.5, 7, {"K1": 3.5}),
        MoveRecord(3.5, 7, {"K1": 3.5}, "hold", "on_end", 3, anyway=True),
        MoveRecord(3.5, 7, {"K1": 3.5}, via={"K1": 4.0}),
        StateRecord(3.7, 7, {"K1": 3.5}, "it was stopped"),
        QueuedRecord(3.0, {"K1": 2.0}),
        EndRecord(4.0, "budget"),
        EndRecord(math.nan, "error", 3, "the machine is gone"),
    ],
    ids=lambda record: type(record).__name__,
)
def test_a_record_survives_the_journal(record: Record) -> None:
    read = from_json(json.loads(journal_line(to_json(record))))
    assert read is not None
    assert same(read, record)


def test_a_problem_survives_its_message_and_so_a_client_knows_it() -> None:
    problem = Problem.from_dict(
        {
            "variables": {
                "K1": {"min": 1.0, "max": 9.0, "unit": "A", "scale": "log", "approach": 0.5},
                "K2": {"fixed": 4.0, "unit": "A"},
                "foil": {"choices": ["thin", "none"], "values": [1, 3], "fixed": "none"},
                "phase": {"min": -1.0, "max": 1.0, "step": 0.25},
            },
            "objectives": {"f": {"reference": 2.0}, "g": {"reference": 1.0, "goal": 0.5}},
            "constraints": {"loss": {"max": 3.0, "critical": True}},
            "observables": {"charge": {"unit": "nC"}},
            "limits": {"total": {"K2": 1.0, "phase": 2.0, "max": 9.0}},
            "context": {
                "hall": {"min": 18.0, "max": 30.0, "unit": "degC"},
                "charge": {"unit": "nC"},
            },
        }
    )
    message = problem_message(problem, "run", Time())
    assert problem_from_message(message) == problem
    assert problem_of(message) == problem


def test_an_evaluation_names_its_contexts() -> None:
    problem = Problem.from_dict(
        PROBLEM.to_dict() | {"context": {"charge": {"unit": "nC"}, "hall": {}}}
    )
    charge, hall = to_message(EVALUATION, problem, "run", CLASSES).contexts
    assert (charge.name, charge.value, charge.unit) == ("charge", 40.0, "nC")
    assert hall.name == "hall"
    assert math.isnan(hall.value)


def test_a_record_survives_its_message() -> None:
    message = to_message(EVALUATION, PROBLEM, "run", CLASSES)
    assert same(from_message(message), EVALUATION)
    assert (message.run_id, message.source) == ("run", msg.Evaluation.OPERATOR)
    assert [(n.name, n.unit) for n in message.setpoint] == [("K1", "A")]
    f, g = message.objectives
    assert (f.name, f.value, f.stddev, f.unit) == ("f", 1.5, 0.1, "mm")
    assert g.name == "g"
    assert math.isnan(g.value)


def test_a_reader_of_bags_sees_the_same_record() -> None:
    """The classes of rosbags, made from the installed definition, serve like those of rclpy."""
    name = "mobo_msgs_py/msg/Evaluation"
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(find_definition(name).text, name))
    data = serialize_message(to_message(EVALUATION, PROBLEM, "run", CLASSES))
    assert same(from_message(store.deserialize_cdr(data, name)), EVALUATION)


@given(st.floats(0.0, 2.0**31 - 1.0))
def test_a_stamp_is_kept_to_the_microsecond(stamp: float) -> None:
    message = to_message(replace(EVALUATION, stamp=stamp), PROBLEM, "run", CLASSES)
    assert from_message(message).stamp == pytest.approx(stamp, abs=1e-6)


@pytest.mark.parametrize("stamp", [math.nan, math.inf, -1.0, 1e300])
def test_a_stamp_that_a_message_cannot_hold_is_zero(stamp: float) -> None:
    message = to_message(replace(EVALUATION, stamp=stamp), PROBLEM, "run", CLASSES)
    assert from_message(message).stamp == 0.0


def test_the_message_has_every_field_of_the_record() -> None:
    in_message = set(msg.Evaluation.get_fields_and_field_types())
    in_record = {field.name for field in fields(EvaluationRecord)} - {"stamp"}
    assert in_message - in_record == {*("header", "run_id", "objectives", "contexts")}
    assert in_record <= in_message


def test_names_and_codes_are_those_of_the_interfaces() -> None:
    kinds = msg.Evaluation
    constants = (kinds.INITIAL, kinds.MODEL, kinds.OPERATOR)
    assert [SOURCES[constant] for constant in constants] == ["initial", "model", "operator"]
    assert history.INVALID_MEASUREMENT == EvaluateSetpoint.Result.INVALID_MEASUREMENT
    assert history.CANCELED == EvaluateSetpoint.Result.CANCELED


def test_another_version_of_the_journal_is_refused() -> None:
    content = to_json(StartRecord("run", 1.0, PROBLEM, {}))
    for version in (0, 2, None, "1"):
        with pytest.raises(ValueError, match="version is"):
            from_json(content | {"version": version})


def test_a_type_that_is_not_known_is_skipped() -> None:
    assert from_json({"type": "weather", "rain": True}) is None


def test_a_message_with_a_source_that_does_not_exist_is_refused() -> None:
    message = to_message(EVALUATION, PROBLEM, "run", CLASSES)
    message.source = 9
    with pytest.raises(ValueError, match="9; 0 to 2 is allowed"):
        from_message(message)


def test_what_a_failed_evaluation_teaches() -> None:
    code = EvaluateSetpoint.Result
    whole = {"f": (1.0, 0.1), "g": (2.0, 0.1)}
    partly = {"f": (1.0, 0.1), "g": (math.nan, math.nan)}

    def failed(diagnostics: dict[str, tuple[float, float]], error_code: int) -> bool | None:
        told = history.told(
            PROBLEM, {"K1": 1.0}, diagnostics, {}, error_code, history.SETPOINT, 1.0
        )
        return told.failed

    assert failed(whole, code.NONE) is None
    assert failed(partly, code.NONE) is None
    assert failed(partly, code.INVALID_MEASUREMENT) is None  # f was measured
    assert failed(whole, code.INVALID_MEASUREMENT) is True
    assert failed({}, code.INVALID_MEASUREMENT) is True
    assert failed(whole, code.VIOLATION) is True


def test_readbacks_are_told_where_the_models_learn_from_them() -> None:
    readbacks = {"K1": 1.25, "elsewhere": 3.0}
    for model_input, expected in ((history.SETPOINT, {}), (history.READBACK, {"K1": 1.25})):
        told = history.told(PROBLEM, {"K1": 1.0}, {}, readbacks, 0, model_input, math.nan)
        assert told.readbacks == expected
