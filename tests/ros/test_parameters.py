"""Parameters of a node: from its files and its command line, declared, checked and dumped."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import NoneType
from typing import Any

import pytest
import rclpy
import yaml
from rclpy.context import Context
from rclpy.node import Node

from mobo_tuner.errors import FileError, ParameterError
from mobo_tuner.parameter_file import check_section, flat
from mobo_tuner.parameter_spec import ParameterSpec
from mobo_tuner.ros.parameters import (
    as_node_arguments,
    declare,
    given_parameters,
    refuse_undeclared,
    refuse_unknown,
    take_given,
)

SPECS = (
    ParameterSpec("count", 3, "How many.", minimum=1),
    ParameterSpec("speed", 100.0, "How fast [1]."),
    ParameterSpec("mean", "auto", "A mean.", choices=("auto",), types=(str, float)),
    ParameterSpec("scales", None, "Scales.", types=(float, tuple, NoneType)),
    ParameterSpec("weights", (1.0, 2.0), "Weights."),
    ParameterSpec("folder", "", "A folder."),
    ParameterSpec("below.this", 1, "A setting."),
    ParameterSpec("open", True, "Whether it is open.", writable=True),
)
DEFAULTS = {spec.name: spec.default for spec in SPECS}


@contextmanager
def node_with(domain: int, *arguments: str, name: str = "tuner") -> Iterator[Node]:
    """A node that is started with a command line."""
    context = Context()
    with as_node_arguments(["program", *arguments], name) as words:
        rclpy.init(args=words, context=context, domain_id=domain)
    node = Node(name, context=context, automatically_declare_parameters_from_overrides=True)
    try:
        yield node
    finally:
        node.destroy_node()
        context.try_shutdown()


@pytest.mark.parametrize(
    ("rule", "reason"),
    [
        ("__ns:=/2A", "the namespace '/2A' is not allowed"),
        ("__ns:=lab", "the namespace 'lab' is not allowed"),
        ("__node:=9x", "the node name '9x' is not allowed"),
        ("tuner:__node:=a-b", "the node name 'a-b' is not allowed"),
    ],
)
def test_a_name_that_ros_does_not_allow_is_one_sentence(rule: str, reason: str) -> None:
    words = ["program", "--ros-args", "-r", rule]
    with pytest.raises(ParameterError) as refused, as_node_arguments(words, "tuner"):
        pass
    (sentence,) = str(refused.value).splitlines()
    assert reason in sentence


def written(path: Path, section: dict[str, Any], name: str = "tuner") -> str:
    path.write_text(yaml.safe_dump({name: {"ros__parameters": section}}))
    return str(path)


def test_a_node_reads_a_file_as_every_other_reader_does(ros_domain: int, tmp_path: Path) -> None:
    """Newtons are no truth value, aliases are resolved, and numbers are those of people."""
    path = tmp_path / "file.yaml"
    path.write_text(
        """tuner:
  ros__parameters:
    x: &x {unit: N, min: -1e-3, max: 2E3, named: y, is_on: yes}
    z: {<<: *x, max: 3.0}
    texts: ['1e5', 1:30, 010, 1_000]
"""
    )
    words = ("--ros-args", "--params-file", str(path), "-p", "unit:=N", "-p", "least:=1e-3")
    with node_with(ros_domain, *words) as node:
        assert (node.get_parameter("unit").value, node.get_parameter("least").value) == ("N", 1e-3)
        declared: Mapping[str, Any] = node.get_parameters_by_prefix("")
        read = {name: parameter.value for name, parameter in declared.items()}
    x = {"unit": "N", "min": -1e-3, "max": 2e3, "named": "y", "is_on": True}
    for name, values in (("x", x), ("z", x | {"max": 3.0})):
        assert {leaf: read[f"{name}.{leaf}"] for leaf in x} == values
    assert read["texts"] == ["1e5", "1:30", "010", "1_000"]


def declared(domain: int, *arguments: str) -> dict[str, Any]:
    with node_with(domain, *arguments) as node:
        return declare(node, SPECS)


def test_defaults_hold_where_nothing_is_given(ros_domain: int) -> None:
    with node_with(ros_domain) as node:
        assert declare(node, SPECS) == DEFAULTS
        descriptor = node.describe_parameter("count")
        assert descriptor.description == "How many."
        assert descriptor.additional_constraints == "at least 1"
        assert descriptor.read_only
        assert not node.describe_parameter("open").read_only


def test_a_file_may_give_every_type(ros_domain: int, tmp_path: Path) -> None:
    section = {
        "count": 4,
        "speed": 50,
        "mean": 2,
        "scales": [1, 2],
        "weights": [0.5, 1e-7],
        "below": {"this": 7},
        "open": False,
    }
    file = written(tmp_path / "a.yaml", section)
    expected = DEFAULTS | {
        "count": 4,
        "speed": 50.0,
        "mean": 2.0,
        "scales": (1.0, 2.0),
        "weights": (0.5, 1e-7),
        "below.this": 7,
        "open": False,
    }
    assert declared(ros_domain, "--ros-args", "--params-file", file) == expected
    assert check_section("tuner", section, SPECS) == expected
    assert dict(flat(section)).keys() <= expected.keys()


@pytest.mark.parametrize("section", ["tunner", "/**/tner", "/tuners"])
def test_a_misspelt_section_is_refused(tmp_path: Path, section: str) -> None:
    file = written(tmp_path / "a.yaml", {"count": 4}, section)
    words = ["program", "--ros-args", "--params-file", file]
    with (
        pytest.raises(ParameterError, match=r"did you mean 'tuner'"),
        as_node_arguments(words, "tuner"),
    ):
        pass
    with as_node_arguments(words, "recorder"):  # a file may be for several nodes
        pass
    second = written(tmp_path / "b.yaml", {"count": 4}, "/**/tuner2")
    with as_node_arguments(["program", "--ros-args", "--params-file", second], "tuner"):
        pass


def test_a_file_that_cannot_be_read_is_one_sentence_without_words_of_ros(tmp_path: Path) -> None:
    repeated = tmp_path / "a.yaml"
    repeated.write_text("/**:\n  ros__parameters:\n    seed: 1\n    seed: 2\n")
    for file, reason in ((tmp_path / "none.yaml", "cannot be read"), (repeated, "stands twice")):
        words = ["program", "--ros-args", "--params-file", str(file)]
        with pytest.raises(FileError, match=reason), as_node_arguments(words, "tuner"):
            pass


@pytest.mark.parametrize("section", ["tuner", "/**"])
def test_what_has_no_value_in_a_file_is_not_given(
    ros_domain: int, tmp_path: Path, section: str
) -> None:
    quantities = {
        "observables": {"x": {}, "y": None, "z": {"unit": "mm"}},
        "objectives": {"f": {"reference": None, "invalid": [], "truncation": [0.5, 2.0]}},
        "constraints": None,
        "limits": {},
    }
    file = written(tmp_path / "a.yaml", {**quantities, "speed": 5.0, "mean": None}, section)
    with node_with(ros_domain, "--ros-args", "--params-file", file) as node:
        assert given_parameters(node) == {
            "observables.x.unit": "",  # named by an entry that all quantities can have
            "observables.y.unit": "",
            "observables.z.unit": "mm",
            "objectives.f.truncation": [0.5, 2.0],
            "speed": 5.0,
        }


def test_names_of_a_control_system_are_kept(ros_domain: int, tmp_path: Path) -> None:
    names = ("beam.sigma/x.1", "LI20:QUAD:Q1:BCTRL", "sys/q-1", "P" * 200)
    variables = {name: {"min": float(i), "max": 9.0} for i, name in enumerate(names)}
    limits = {"total": {"beam.sigma/x.1": 1.0, "max": 3.0}}
    content = {"variables": variables, "limits": limits, "count": 4}
    file = written(tmp_path / "a.yaml", content)
    with node_with(ros_domain, "--ros-args", "--params-file", file) as node:
        given = given_parameters(node)
    assert given == dict(flat(content))


@pytest.mark.parametrize("section", ["tuner", "/tuner", "/**/tuner", "/**"])
@pytest.mark.parametrize("first", [True, False], ids=["before", "after"])
def test_the_command_line_wins_over_the_files(
    ros_domain: int, tmp_path: Path, section: str, first: bool
) -> None:
    file = written(tmp_path / "a.yaml", {"count": 4, "speed": 5.0, "scales": 3.0}, section)
    line = ["-p", "count:=9", "--param", "speed:=1e-5", "-p", "scales:=[1.0, 2.5]"]
    line += ["-p", "mean:=auto", "-p", "folder:=/some:where else", "-p", "below.this:=2"]
    files = ["--params-file", file]
    order = [*line, *files] if first else [*files, *line]
    assert declared(ros_domain, "--ros-args", *order) == DEFAULTS | {
        "count": 9,
        "speed": 1e-5,
        "scales": (1.0, 2.5),
        "folder": "/some:where else",
        "below.this": 2,
    }


def test_the_command_line_wins_whatever_the_node_is_called(ros_domain: int, tmp_path: Path) -> None:
    files = ["--params-file", written(tmp_path / "a.yaml", {"count": 4}, "/**")]
    names = ["-r", "__ns:=/cave", "-r", "__node:=second"]
    assert declared(ros_domain, "--ros-args", *files, "-p", "count:=9", *names)["count"] == 9


def test_what_is_dumped_can_be_loaded(ros_domain: int, tmp_path: Path) -> None:
    given = written(tmp_path / "a.yaml", {"speed": 3, "weights": [4.0, 5.0], "mean": 1.5})
    with node_with(ros_domain, "--ros-args", "--params-file", given) as node:
        values = declare(node, SPECS)
        # As `ros2 param dump` writes it: null for what is not set.
        declared: Mapping[str, Any] = node.get_parameters_by_prefix("")
        dump = {
            name: list(p.value) if hasattr(p.value, "tolist") else p.value
            for name, p in declared.items()
        }
    assert dump["scales"] is None
    dumped = written(tmp_path / "dump.yaml", dump)
    with node_with(ros_domain, "--ros-args", "--params-file", dumped) as node:
        given_names = given_parameters(node)
        refuse_unknown(given_names, [spec.name for spec in SPECS])
        assert declare(node, SPECS) == values


def test_an_unknown_parameter_is_refused_with_the_nearest_known_one(
    ros_domain: int, tmp_path: Path
) -> None:
    known = [*(spec.name for spec in SPECS), "constraints"]
    for section, words in (
        ({"conut": 3}, "'conut' is unknown in the node; did you mean 'count'"),
        ({"constraint": {"dE": {"max": 1.0}}}, "'constraint' is unknown in the node; did you mean"),
        ({"below": {"that": 3}}, "'below.that' is unknown in the node; did you mean 'below.this'"),
        ({"constraints": {"dE": {"max": 1.0}}, "count": 4}, ""),
    ):
        file = written(tmp_path / "a.yaml", section)
        with node_with(ros_domain, "--ros-args", "--params-file", file) as node:
            given = given_parameters(node)
            if words:
                with pytest.raises(ParameterError, match=words):
                    refuse_unknown(given, known)
            else:
                refuse_unknown(given, known)


def test_a_value_that_is_not_allowed_is_refused(ros_domain: int) -> None:
    for text, name in (("count:=0", "count"), ("scales:=x", "scales"), ("open:=1", "open")):
        with pytest.raises(ParameterError, match=name):
            declared(ros_domain, "--ros-args", "-p", text)


REMAPPED = (
    (),
    ("-r", "__ns:=/A"),
    ("-r", "__node:=tuner2"),
    ("-r", "tuner:__node:=tuner2", "-r", "__ns:=/A/B"),
)


@pytest.mark.parametrize("section", ["tuner", "/tuner", "/**/tuner"])
@pytest.mark.parametrize("remapping", REMAPPED, ids=" ".join)
def test_the_nodes_own_section_holds_under_any_name(
    ros_domain: int, tmp_path: Path, section: str, remapping: tuple[str, ...]
) -> None:
    content = {
        "/**": {"ros__parameters": {"count": 4, "speed": 5.0}},
        section: {"ros__parameters": {"count": 6, "weights": [0.5, 1e-7]}},
        "recorder": {"ros__parameters": {"folder": "/not/for/the/tuner"}},
    }
    file = tmp_path / "a.yaml"
    file.write_text(yaml.safe_dump(content))
    expected = DEFAULTS | {"count": 6, "speed": 5.0, "weights": (0.5, 1e-7)}
    line = ["--ros-args", *remapping, "--params-file", str(file)]
    assert declared(ros_domain, *line) == expected
    assert declared(ros_domain, *line, "-p", "count:=9")["count"] == 9
    assert declared(ros_domain, *line, "-p", "tuner:count:=9")["count"] == 9
    assert declared(ros_domain, *line, "-p", "other:count:=9")["count"] == 6


def test_a_section_for_the_full_name_wins_over_that_of_the_original_name(
    ros_domain: int, tmp_path: Path
) -> None:
    content = {
        "tuner": {"ros__parameters": {"count": 6}},
        "/A/*": {"ros__parameters": {"speed": 7.0}},
    }
    file = tmp_path / "a.yaml"
    file.write_text(yaml.safe_dump(content))
    line = ["--ros-args", "--params-file", str(file)]
    assert declared(ros_domain, *line)["count"] == 6
    values = declared(ros_domain, *line, "-r", "__ns:=/A")
    assert (values["count"], values["speed"]) == (DEFAULTS["count"], 7.0)


@pytest.mark.parametrize(
    ("name", "section", "sentence"),
    [
        ("conut", "/**/tuner", "'conut' is unknown in the node; did you mean 'count'"),
        ("below.that", "/**/tuner", "'below.that' is unknown in the node; did you mean"),
        ("objectives.f1", "/**/tuner", "'objectives.f1' is unknown"),
        ("conut", "/**", "'conut' is unknown in the node; did you mean 'count'"),
        ("objectives.f1", "/**", ""),
        ("count", "/**/recorder", ""),
    ],
)
def test_an_undeclared_parameter_is_refused_unless_it_may_be_another_nodes(
    ros_domain: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    name: str,
    section: str,
    sentence: str,
) -> None:
    file = written(tmp_path / "a.yaml", {name: 3, "count": 4}, section)
    line = ["--ros-args", "--params-file", file, "-p", "use_sim_time:=true"]
    monkeypatch.setattr("sys.argv", ["program", *line])
    with node_with(ros_domain, *line) as node:
        given = take_given(node)
        assert not node.has_parameter("count")
        expected = DEFAULTS["count"] if section == "/**/recorder" else 4
        assert declare(node, SPECS)["count"] == expected
        if sentence:
            with pytest.raises(ParameterError, match=sentence):
                refuse_undeclared(node, given)
        else:
            refuse_undeclared(node, given)
