"""Types by name and fields by path, on the types of packages that everybody has."""

from __future__ import annotations

import math
import re
from typing import Any

import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseWithCovariance
from hypothesis import given
from hypothesis import strategies as st
from rcl_interfaces.srv import SetParameters
from sensor_msgs.msg import Image, JointState
from std_msgs.msg import Float32, Float64, UInt8

from mobo_tuner.bridge.field_path import parse_field_path
from mobo_tuner.bridge.interface_types import (
    FieldError,
    check_boolean,
    check_readable,
    check_time,
    fill,
    load_type,
    read,
    write,
)

JOINTS = JointState(name=["Q1", "Q2"], position=[1.0, 2.0])
STATUS = DiagnosticStatus(
    values=[KeyValue(key="K1", value="3.5"), KeyValue(key="K2", value="open")]
)


def read_at(message: Any, path: str) -> Any:
    return read(message, parse_field_path(path))


def written(message: Any, **numbers: float) -> Any:
    for path, number in numbers.items():
        write(message, parse_field_path(path), number)
    return message


def test_types_are_loaded_by_name() -> None:
    assert load_type("std_msgs/msg/Float64") is Float64
    assert load_type("rcl_interfaces/srv/SetParameters") is SetParameters


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("std_msgs/msg/Float65", "the type std_msgs/msg/Float65 is not installed"),
        ("no_such/msg/Float64", "the type no_such/msg/Float64 is not installed"),
        ("std_msgs/Float64", "is not a type's name"),
        ("os/path/join", "is not a type's name"),
        ("os.path/msg/Join", "is not a type's name"),
        ("std_msgs/msg/Float64\n", "is not a type's name"),
        ("../x/msg/A", "is not a type's name"),
    ],
)
def test_what_is_no_type_is_not_loaded(name: str, sentence: str) -> None:
    with pytest.raises(FieldError, match=re.escape(sentence)):
        load_type(name)


def test_fields_are_read() -> None:
    assert read_at(Float64(data=2.5), "data") == 2.5
    assert read_at(JOINTS, "position[1]") == 2.0
    assert read_at(JOINTS, "position[name=Q2]") == 2.0
    assert read_at(JOINTS, "name[0]") == "Q1"
    assert read_at(STATUS, "values[key=K1].value") == "3.5"
    assert read_at(PoseWithCovariance(), "covariance[35]") == 0.0
    for path in ("position[2]", "position[name=Q3]", "velocity[name=Q1]"):
        with pytest.raises(FieldError, match="the message has no"):
            read_at(JOINTS, path)


@pytest.mark.parametrize(
    ("kind", "path", "sentence"),
    [
        (Float64, "value", "Float64 has no field 'value'; it has data"),
        (Float64, "data.x", "data.x: double has no field 'x'"),
        (Float64, "data[0]", "data[0]: double is not an array"),
        (JointState, "position", "position is an array of double; a number"),
        (JointState, "position[velocity=Q1]", "'velocity' is not an array of strings to select by"),
        (JointState, "position[label=Q1]", "JointState has no field 'label'"),
        (JointState, "header", "header is std_msgs/msg/Header; a number"),
        (PoseWithCovariance, "covariance[36]", "the array has 36 elements, counted from 0"),
        (DiagnosticStatus, "values.value", "an array of diagnostic_msgs/msg/KeyValue has no field"),
        (DiagnosticStatus, "values[name=K1].value", "KeyValue has no field 'name'"),
        (DiagnosticStatus, "level", "level is octet"),
    ],
)
def test_a_path_that_does_not_fit_its_type_is_named(kind: Any, path: str, sentence: str) -> None:
    with pytest.raises(FieldError, match=re.escape(sentence)):
        check_readable(kind, parse_field_path(path))


def test_paths_that_fit_are_accepted() -> None:
    for kind, path in (
        (Float64, "data"),
        (JointState, "position[name=Q1]"),
        (JointState, "effort[7]"),
        (DiagnosticStatus, "values[key=K1].value"),
        (Image, "data[0]"),
        (Image, "is_bigendian"),
    ):
        check_readable(kind, parse_field_path(path))
    check_time(JointState, parse_field_path("header.stamp"))
    check_boolean(SetParameters.Response, parse_field_path("results[0].successful"))
    with pytest.raises(FieldError, match="Time is required"):
        check_time(JointState, parse_field_path("header"))
    with pytest.raises(FieldError, match="a boolean is required"):
        check_boolean(JointState, parse_field_path("position[0]"))


def test_numbers_are_written_and_arrays_grow() -> None:
    joints = written(JointState(), **{"position[name=Q2]": 2.0, "position[name=Q1]": 1.0})
    assert (list(joints.name), list(joints.position)) == (["Q2", "Q1"], [2.0, 1.0])
    written(joints, **{"position[name=Q2]": 5.0})
    assert list(joints.position) == [5.0, 1.0]
    assert list(written(JointState(), **{"position[2]": 3.0}).position) == [0.0, 0.0, 3.0]
    request = written(
        SetParameters.Request(), **{"parameters[name=K1].value.double_value": 7.5}
    ).parameters
    assert [(p.name, p.value.double_value) for p in request] == [("K1", 7.5)]
    pose = written(PoseWithCovariance(), **{"covariance[35]": 2.0, "pose.position.x": 3.0})
    assert (pose.covariance[35], pose.pose.position.x) == (2.0, 3.0)
    assert written(UInt8(), data=254.6).data == 255


@pytest.mark.parametrize(
    ("message", "path", "number", "sentence"),
    [
        (UInt8(), "data", 256.0, "data would be 256; uint8 takes 0 to 255"),
        (UInt8(), "data", -1.0, "data would be -1; uint8 takes 0 to 255"),
        (Float32(), "data", 1e39, "data would be 1e+39, which is too large for a float32"),
        (Float64(), "data", math.nan, "data would be nan, which is not finite"),
        (JointState(), "name[0]", 1.0, "name[0] is text, not a number"),
        (JointState(), "position", 1.0, "position is an array of double, not a number"),
        (PoseWithCovariance(), "covariance[36]", 1.0, "the array has 36 elements"),
        (PoseWithCovariance(), "pose.x", 1.0, "Pose has no field 'x'"),
    ],
)
def test_a_number_that_does_not_fit_is_named(
    message: Any, path: str, number: float, sentence: str
) -> None:
    with pytest.raises(FieldError, match=re.escape(sentence)):
        write(message, parse_field_path(path), number)


def test_messages_are_filled_as_a_file_says() -> None:
    joints = JointState()
    fill(joints, {"name": ["a"], "position": [1, 2.5], "header": {"frame_id": "x"}})
    assert (joints.header.frame_id, list(joints.position)) == ("x", [1.0, 2.5])
    request = SetParameters.Request()
    fill(request, {"parameters": [{"name": "n", "value": {"type": 3, "bool_value": True}}]})
    assert (request.parameters[0].value.type, request.parameters[0].value.bool_value) == (3, True)


@pytest.mark.parametrize(
    ("message", "content", "sentence"),
    [
        (JointState(), {"names": []}, "JointState has no field 'names'"),
        (JointState(), {"name": "a"}, "name is str; it must be an array of text"),
        (JointState(), {"name": [1]}, "name[0] is int; it must be text"),
        (JointState(), {"header": 1}, "header is int; it must be std_msgs/msg/Header"),
        (JointState(), {"header": {"stamp": {"sec": 1.5}}}, "sec is 1.5; it must be an integer"),
        (Time(), {"nanosec": -1}, "nanosec would be -1; uint32 takes 0 to"),
        (Float64(), {"data": True}, "data is bool; it must be double"),
        (PoseWithCovariance(), {"covariance": [0.0]}, "covariance has 1 elements; it is an array"),
    ],
)
def test_a_value_that_does_not_fit_is_named(message: Any, content: Any, sentence: str) -> None:
    with pytest.raises(FieldError, match=re.escape(sentence)):
        fill(message, content)


TREES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(["name", "position", "header", "stamp", "sec", "frame_id"]), inner
        )
    ),
    max_leaves=10,
)
KINDS = st.sampled_from([JointState, DiagnosticStatus, PoseWithCovariance, SetParameters.Request])
WORDS = st.sampled_from(["name", "position", "header", "stamp", "values", "key", "pose", "x"])
PATHS = st.lists(
    st.builds(
        "{}{}".format, WORDS, st.sampled_from(["", "[0]", "[3]", "[name=a]", "[key=b]", "[x=y]"])
    ),
    min_size=1,
    max_size=3,
).map(".".join)


@given(KINDS, st.dictionaries(st.text(max_size=5) | WORDS, TREES, max_size=3), PATHS, st.floats())
def test_whatever_is_asked_of_a_message_is_done_or_refused(
    kind: Any, content: dict[str, Any], text: str, number: float
) -> None:
    path, message = parse_field_path(text), kind()
    for act in (
        lambda: fill(message, content),
        lambda: check_readable(kind, path),
        lambda: write(message, path, number),
    ):
        try:
            act()
        except FieldError:
            continue
    try:
        check_readable(kind, path)
        read(message, path)
    except FieldError:
        return
