"""Layouts for viewers: every topic, path, service and series is that of the interfaces."""

from __future__ import annotations

import importlib
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from mobo_tuner.core.problem import Problem
from mobo_tuner.displays.layouts import layouts, main
from mobo_tuner.ros import interfaces
from tests.support.paths import CONFIG

TOPICS = {f"/{topic.name.lstrip('/')}": topic.kind for topic in interfaces.TOPICS}
SERVICES = {f"/{service.name}" for service in interfaces.SERVICES}
FILES = ("awa.yaml", "toy.yaml")
STEP = re.compile(r'\.(\w+)(\[:\])?(?:\{(\w+)=="([^"]*)"\})?')


def problem_of(file: str) -> Problem:
    return Problem.from_yaml(CONFIG / file)


def type_of(kind: Any, field: str) -> tuple[Any, bool]:
    """Class, or name, of the type of a message's field, and whether the field is a list."""
    name = kind.get_fields_and_field_types()[field]
    element = re.fullmatch(r"sequence<(.+)>|(.+)\[\d*\]", name)
    is_list = element is not None
    if element:
        name = element[1] or element[2]
    if "/" in name:
        package, message = name.split("/")
        return getattr(importlib.import_module(f"{package}.msg"), message), is_list
    return name, is_list


def topic_type(topic: str) -> Any:
    """Type of a topic; that of a quantity's own topic is named after it."""
    return TOPICS["/plot/<name>"] if topic.startswith("/plot/") else TOPICS[topic]


def resolve(path: str, names: set[str]) -> Any:
    """Type of what a message path of Lichtblick leads to."""
    topic = re.match(r"[/\w]+", path)
    assert topic, path
    kind, rest = topic_type(topic[0]), path[topic.end() :]
    while rest:
        step = STEP.match(rest)
        assert step, path
        kind, is_list = type_of(kind, step[1])
        assert is_list == bool(step[2]), path
        if step[3]:
            assert type_of(kind, step[3]) == ("string", False)
            assert step[4] in names, path
        rest = rest[step.end() :]
    return kind


def panels(node: Any, configs: dict[str, Any]) -> Iterator[str]:
    """Identifiers of the panels of a layout, those in tabs too."""
    if isinstance(node, dict):
        assert node["direction"] in ("row", "column")
        assert 0.0 < node["splitPercentage"] < 100.0
        yield from panels(node["first"], configs)
        yield from panels(node["second"], configs)
        return
    yield node
    for tab in configs[node].get("tabs", ()):
        yield from panels(tab["layout"], configs)


@pytest.mark.parametrize("file", FILES)
@pytest.mark.parametrize("kind", ["live", "bag"])
def test_every_path_of_lichtblick_leads_to_a_number(file: str, kind: str) -> None:
    problem = problem_of(file)
    layout = json.loads(layouts(problem)[f"lichtblick_{kind}.json"])
    configs = layout["configById"]
    assert sorted(panels(layout["layout"], configs)) == sorted(configs)
    names = {*problem.variable_names, *problem.units, *problem.required_diagnostics}
    plotted, called = set(), set()
    for config in configs.values():
        paths = [path["value"] for path in config.get("paths", ())]
        paths += [config["xAxisPath"]["value"]] if "xAxisPath" in config else []
        for path in paths:
            if path.startswith("/"):
                assert resolve(path, names) in ("double", "float")
                plotted |= {*re.findall(r'"([^"]+)"', path)}
            else:
                float(path)  # a horizontal line
        if "topicToRender" in config:
            assert resolve(config["topicToRender"], names) is TOPICS["/diagnostics"]
        if "path" in config:
            assert resolve(config["path"], names) == "uint8"
        if "topicPath" in config:
            resolve(config["topicPath"], names)
        if "serviceName" in config:
            called.add(config["serviceName"])
            assert config["requestPayload"] == "{}"
    observables = {o.name for o in problem.observables}
    assert plotted == {*problem.variable_names, *problem.required_diagnostics, *observables}
    buttons = {"/pause", "/resume", "/step", "/skip", "/stop_after_this"}
    assert called == (buttons if kind == "live" else set())
    assert buttons <= SERVICES


@pytest.mark.parametrize("file", FILES)
def test_every_series_of_plotjuggler_is_a_number_of_a_topic(file: str) -> None:
    problem = problem_of(file)
    root = ElementTree.fromstring(layouts(problem)["plotjuggler.xml"])
    series = [curve.attrib["name"] for curve in root.iter("curve")]
    series += [t.attrib["axisX"] for t in root.iter("transform") if "axisX" in t.attrib]
    for name in series:
        topic = re.match(r"/plot/\w+|/\w+", name)
        assert topic
        kind = topic_type(topic[0])
        for field, index in re.findall(r"/(\w+)(?:\[(\d+)\])?", name[topic.end() :]):
            kind, is_list = type_of(kind, field)
            assert is_list == bool(index), name
            if field == "objectives":
                assert int(index) < len(problem.objectives)
        assert kind in ("double", "uint32"), name
    wanted = {f"/plot/{name}/data" for name in (*problem.variable_names, *problem.objective_names)}
    assert wanted <= {*series}
    for plot in root.iter("plot"):
        transform, curve = plot.find("transform"), plot.find("curve")
        assert transform is not None
        assert curve is not None
        assert transform.attrib["value"] == curve.attrib["custom_transform"]
    assert len(root.findall(".//transform[@value='XYPlot']")) == (6 if file == "awa.yaml" else 1)


def test_the_layouts_of_a_file_are_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([str(CONFIG / "toy.yaml"), "--output", str(tmp_path)]) == 0
    printed = [Path(line).name for line in capsys.readouterr().out.splitlines()]
    assert sorted(printed) == sorted(path.name for path in tmp_path.iterdir())
    assert main([str(tmp_path / "none.yaml"), "--output", str(tmp_path)]) == 2
    assert "none.yaml" in capsys.readouterr().err
