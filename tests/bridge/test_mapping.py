"""Mapping files: the shipped ones, every mistake in one sentence, and whatever else a file may hold."""

from __future__ import annotations

import copy
import math
import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mobo_tuner.bridge.describe import mapping_file
from mobo_tuner.bridge.mapping import load_mapping, parse_mapping
from mobo_tuner.bridge.section import MappingError
from mobo_tuner.machine.averaging import OutlierRule

CONFIG = Path(__file__).parents[2] / "config"
MAPPINGS = sorted(CONFIG.glob("bridge_*.yaml"))
FOREIGN = yaml.safe_load((CONFIG / "bridge_foreign.yaml").read_text(encoding="utf-8"))
MISSING = object()


def changed(path: str, value: Any) -> dict[str, Any]:
    """The foreign machine's mapping with one key changed, added, or taken away."""
    content: dict[str, Any] = copy.deepcopy(FOREIGN)
    branch: Any = content
    *parents, leaf = path.split(".")
    for parent in parents:
        branch = branch[parent]
    if value is MISSING:
        del branch[leaf]
    else:
        branch[leaf] = value
    return content


def test_the_manual_names_every_key() -> None:
    manual = (CONFIG.parent / "docs" / "bridge.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (`[^|]*`) \|", manual, flags=re.MULTILINE)
    named = {word for row in rows for word in re.findall(r"\w+", row)}
    source = (CONFIG.parent / "src/mobo_tuner/mobo_tuner/bridge/mapping.py").read_text()
    asked = re.findall(
        r"\.(?:get|number|whole|text|choice|section|sections)\(\s*\"(\w+)\"|_path\(section, \"(\w+)\"",
        source,
    )
    assert len(asked) > 25
    keys = {a or b for a, b in asked} - {"equals"}  # of a condition, in the text below the table
    assert keys <= named
    assert "`equals: value`" in manual


@pytest.mark.parametrize("path", MAPPINGS, ids=lambda path: path.name)
def test_every_shipped_mapping_is_good(path: Path) -> None:
    mapping = load_mapping(path)
    assert mapping.file == path.name
    assert mapping.variables
    assert mapping.diagnostics


def test_a_mapping_is_what_its_file_says() -> None:
    mapping = parse_mapping(FOREIGN, "f.yaml")
    x1 = mapping.variables["x1"]
    assert (x1.minimum, x1.maximum, x1.max_step, x1.slew, x1.tolerance) == (-2, 2, 0.25, 4, 0.01)
    assert str(x1.setpoint.target) == "topic 'supplies/command'"
    assert str(x1.setpoint.field) == "position[name=Q1]"
    assert x1.setpoint.raw(1.5) == 1500.0
    assert x1.readback.value(1500) == 1.5
    assert (x1.readback.stale_after, x1.settled) == (1.0, None)
    f1 = mapping.diagnostics["f1"]
    assert (f1.count, f1.seconds, f1.outliers) == (2, 0.0, OutlierRule("mad", 5.0))
    assert f1.read.message == {"names": ["f1"]}
    assert mapping.fire is not None
    assert str(mapping.fire.success) == "success"
    assert (mapping.rate, mapping.settle_time, mapping.settle_timeout) == (20.0, 0.2, 3.0)
    assert not mapping.follow_moved


def test_values_are_numbers_truths_or_numeric_texts() -> None:
    readback = parse_mapping(FOREIGN, "f.yaml").variables["x1"].readback
    assert [readback.value(raw) for raw in (True, "2e3", 5)] == [0.001, 2.0, 0.005]
    assert all(math.isnan(readback.value(raw)) for raw in ("2 A", "", None, [1.0], b"\xff"))


def test_conditions_hold_when_equal_or_within_limits() -> None:
    def condition(**keys: Any) -> Any:
        content = changed("interlocks.permit", FOREIGN["interlocks"]["permit"] | keys)
        if "equals" not in keys:
            del content["interlocks"]["permit"]["equals"]
        return parse_mapping(content, "f.yaml").interlocks["permit"]

    assert [condition().holds(raw) for raw in (True, False)] == [True, False]
    assert [condition(equals="open").holds(raw) for raw in ("open", "shut")] == [True, False]
    limited = condition(min=1.0, max=2)
    assert [limited.holds(raw) for raw in (0.9, 1.0, 2.0, 2.1, math.nan, "x")] == [
        False, True, True, False, False, False
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("path", "value", "sentence"),
    [
        ("name", MISSING, "f.yaml: name is missing"),
        ("name", 3, "f.yaml: name is 3; it must be a text"),
        ("varables", {}, "f.yaml: varables is unknown; allowed there are move, measure, name"),
        ("variables", {}, "f.yaml: variables is {}; it must have at least one entry"),
        ("variables", [1], "f.yaml: variables is [1]; it must be a mapping with text keys"),
        ("variables.x1.slew", MISSING, "f.yaml: variables.x1.slew is missing"),
        ("variables.x1.slew", 0, "variables.x1.slew is 0; it must be a number above 0"),
        ("variables.x1.slew", True, "variables.x1.slew is True; it must be a number above 0"),
        ("variables.x1.slew", math.inf, "variables.x1.slew is inf; it must be a number"),
        ("variables.x1.slew", math.nan, "variables.x1.slew is nan; it must be a number"),
        ("variables.x1.slew", 10**400, "it must be a number above 0"),
        ("variables.x1.max", -2.0, "variables.x1.max is -2.0; it must be a number above -2"),
        ("variables.x 1", FOREIGN["variables"]["x1"], "this name is not valid"),
        ("variables.x1.setpoint.scale", 0.0, "setpoint.scale is 0.0; it must not be 0"),
        ("variables.x1.setpoint.type", "os/system", "it must be like package/msg/Type"),
        ("variables.x1.setpoint.type", "std_srvs/srv/Trigger", "like package/msg/Type"),
        ("variables.x1.setpoint.topic", "a b", "it must be the name of a topic"),
        ("variables.x1.setpoint.service", "a", "must have one of the keys topic, service, action"),
        ("variables.x1.setpoint.field", "__class__", "setpoint.field: '__class__' is not a path"),
        ("variables.x1.setpoint.stale_after", 1.0, "setpoint.stale_after is unknown; allowed"),
        ("variables.x1.readback.stale_after", -1, "it must be a number above 0"),
        ("variables.x1.readback.qos", "sensor", "one of reliable, best_effort, latched"),
        ("variables.x1.readback", {"action": "a"}, "must have one of the keys topic, service"),
        ("diagnostics.f1.outliers", {"mad": 3, "sigma": 3}, "one of the keys mad, sigma; it has"),
        ("diagnostics.f1.statistic", "p101", "'p101'; allowed are mean, rms, and p0 to p100"),
        ("diagnostics.f1.statistic", 90, "diagnostics.f1.statistic is 90; it must be a text"),
        ("diagnostics.f1.average", {"count": 3}, "with measure.fire the shots are measure.shots"),
        ("diagnostics.x1", FOREIGN["diagnostics"]["f1"], "x1 is a variable and a diagnostic"),
        ("measure.shots", 2.5, "measure.shots is 2.5; it must be an integer from 1 to 10000"),
        ("measure.fire.success", "", "measure.fire.success is ''; it must be a text"),
        ("move.if_moved", "jump", "move.if_moved is 'jump'; it must be one of refuse, follow"),
        ("move.rate", 1e9, "move.rate is 1000000000.0; it must be a number above 0 and at most"),
        ("interlocks.permit.min", 0.0, "it must be one value, and stand without min and max"),
    ],
)
def test_a_mistake_is_named(path: str, value: Any, sentence: str) -> None:
    with pytest.raises(MappingError) as caught:
        parse_mapping(changed(path, value), "f.yaml")
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    file = tmp_path / "m.yaml"
    for text, sentence in (("a: [", "is not valid YAML"), ("7", "must hold a mapping")):
        file.write_text(text, encoding="utf-8")
        with pytest.raises(ValueError, match=sentence):
            load_mapping(file)
    with pytest.raises(ValueError, match="cannot be read"):
        load_mapping(tmp_path / "none.yaml")


def test_a_file_that_is_a_bomb_is_named_in_a_short_sentence(tmp_path: Path) -> None:
    lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 8)}]" for n in range(1, 30)]
    file = tmp_path / "m.yaml"
    file.write_text("\n".join([*lines, "variables: *a29", "name: bomb"]), encoding="utf-8")
    with pytest.raises(ValueError, match="holds more than the 100000 values allowed") as caught:
        load_mapping(file)
    assert len(str(caught.value)) < 300


LEAVES = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.text(max_size=10),
    st.sampled_from(["std_msgs/msg/Float64", "data", "reliable", "follow", "a/b", "position[0]"]),
)
TREES = st.recursive(
    LEAVES,
    lambda children: (
        st.lists(children, max_size=3)
        | st.dictionaries(st.text(max_size=6) | st.integers(), children, max_size=4)
    ),
    max_leaves=12,
)


def paths(content: Any, prefix: str = "") -> list[str]:
    """Every key of a mapping, those of its branches included."""
    if not isinstance(content, dict):
        return []
    return [
        path
        for key in content
        for path in (f"{prefix}{key}", *paths(content[key], f"{prefix}{key}."))
    ]


@settings(max_examples=500, suppress_health_check=[HealthCheck.too_slow])
@given(st.sampled_from(paths(FOREIGN)), TREES | st.just(MISSING))
def test_whatever_stands_at_a_key_is_read_or_refused(path: str, value: Any) -> None:
    try:
        parse_mapping(changed(path, value), "f.yaml")
    except MappingError as error:
        message = str(error)
    else:
        return
    assert message.startswith("f.yaml: ")
    assert message.isprintable()


@given(TREES)
def test_whatever_a_file_holds_is_refused_in_one_sentence(content: Any) -> None:
    with pytest.raises(MappingError, match=r"^f\.yaml: "):
        parse_mapping(content, "f.yaml")


def test_a_mapping_is_relative_to_the_file_that_names_it(tmp_path: Path) -> None:
    mine, launched = tmp_path / "mine" / "a.yaml", tmp_path / "launch_params_1"
    mine.parent.mkdir()
    mine.write_text("/**/machine_bridge: {ros__parameters: {mapping: m.yaml}}")
    launched.write_text("/**: {ros__parameters: {use_sim_time: false}}")
    line = ["--ros-args", "--params-file", str(mine), "--params-file", str(launched)]
    assert mapping_file("m.yaml", line) == mine.parent / "m.yaml"
    assert mapping_file("m.yaml", [*line, "-p", "mapping:=m.yaml"]) == Path("m.yaml")
    assert mapping_file("m.yaml", []) == Path("m.yaml")


def test_a_selector_has_words_in_place_of_numbers() -> None:
    mapping = load_mapping(CONFIG / "bridge_laboratory.yaml")
    ladder = mapping.variables["LI20/target.1"]
    assert (ladder.minimum, ladder.maximum, ladder.words) == (0.0, 2.0, ("none", "foil", "mesh"))
    assert [ladder.setpoint.raw(value) for value in (0.0, 1.0, 2.0)] == ["none", "foil", "mesh"]
    assert ladder.readback.value("mesh") == 2.0
    assert math.isnan(ladder.readback.value("wire"))
    content = yaml.safe_load((CONFIG / "bridge_laboratory.yaml").read_text())
    content["variables"]["LI20/target.1"]["words"] = ["none", "none"]
    with pytest.raises(MappingError, match="at least two different words"):
        parse_mapping(content, "lab.yaml")
