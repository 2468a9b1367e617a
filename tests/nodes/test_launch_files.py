"""The launch files, checked by what launch_xml documents, and the analyzers of the diagnostics.

launch is not in the wheels, so that the files cannot be launched here.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import pytest
import yaml

from awa_sim_node.parameters import AWA_SIM
from mobo_tuner.bridge.describe import MACHINE_BRIDGE
from mobo_tuner.nodes.parameters import CONSOLE, PAGE, RECORDER
from mobo_tuner.parameter_spec import ParameterSpec
from mobo_tuner.tuner.parameters import TUNER
from tests.support.paths import CONFIG, ROOT
from tests.support.processes import NodeStarter

FILES = sorted((ROOT / "src").glob("*/launch/*"))
EXECUTABLES: Mapping[tuple[str, str], tuple[ParameterSpec, ...]] = {
    ("mobo_tuner", "tuner"): TUNER,
    ("mobo_tuner", "recorder"): RECORDER,
    ("mobo_tuner", "console"): CONSOLE,
    ("mobo_tuner", "page"): PAGE,
    ("mobo_tuner", "machine_bridge"): MACHINE_BRIDGE,
    ("awa_sim_node", "awa_sim"): AWA_SIM,
}


MODULES = {
    "tuner": "mobo_tuner.nodes.tuner",
    "recorder": "mobo_tuner.nodes.recorder",
    "console": "mobo_tuner.nodes.console",
    "page": "mobo_tuner.nodes.page",
    "machine_bridge": "mobo_tuner.nodes.machine_bridge",
    "awa_sim": "awa_sim_node.node",
}


class Tag(NamedTuple):
    """What may stand in an element: attributes that it must and may have, and children."""

    needed: frozenset[str]
    allowed: frozenset[str]
    children: frozenset[str]


def tag(needed: str = "", allowed: str = "", children: str = "") -> Tag:
    return Tag(*(frozenset(words.split()) for words in (needed, allowed, children)))


# After "ROS 2 Launch XML Format" of design.ros2.org and the launch pages of docs.ros.org for Jazzy.
SCHEMA = {
    "launch": tag("", "version", "arg let node group include push_ros_namespace set_parameter"),
    "arg": tag("name", "default description value", "choice"),
    "choice": tag("value"),
    "let": tag("name value", "if unless"),
    "group": tag("", "if unless scoped", "arg let node group include push_ros_namespace"),
    "push_ros_namespace": tag("namespace", "if unless"),
    "set_parameter": tag("name value", "if unless"),
    "include": tag("file", "if unless", "arg let"),
    "node": tag(
        "pkg exec",
        "name namespace output args ros_args if unless respawn respawn_delay launch-prefix cwd "
        "output_format exec_name shell sigterm_timeout sigkill_timeout emulate_tty",
        "param remap env",
    ),
    "param": tag("", "name value from allow_substs sep", "param"),
    "remap": tag("from to"),
    "env": tag("name value"),
}
SUBSTITUTION = re.compile(r"\$\((\S+) ?([^()]*)\)")


def check(element: ElementTree.Element) -> None:
    """Check an element and all below it against the schema."""
    rule = SCHEMA[element.tag]
    given = {*element.attrib}
    assert rule.needed <= given <= rule.needed | rule.allowed, element.attrib
    assert not (element.text or "").strip()
    if element.tag == "param":
        assert ("from" in given) != ("name" in given), element.attrib
    for child in element:
        assert child.tag in rule.children, f"<{child.tag}> in <{element.tag}>"
        check(child)


def root_of(path: Path) -> ElementTree.Element:
    return ElementTree.parse(path).getroot()


def test_the_files_are_there() -> None:
    names = ["awa_sim.launch.xml", "machine_bridge.launch.xml", "tune.launch.xml"]
    assert sorted(path.name for path in FILES) == names


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_a_launch_file_is_as_launch_xml_documents(path: Path) -> None:
    root = root_of(path)
    assert root.tag == "launch"
    check(root)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_what_a_launch_file_names_is_there(path: Path) -> None:
    root = root_of(path)
    arguments = {arg.attrib["name"] for arg in root.iter("arg")}
    assert all(arg.attrib.get("description") for arg in root.iter("arg"))
    assert "namespace" in arguments
    used = set()
    for element in root.iter():
        for text in element.attrib.values():
            assert text.count("$(") == len(SUBSTITUTION.findall(text)), text
            for kind, name in SUBSTITUTION.findall(text):
                if kind == "var":
                    used.add(name)
                else:
                    assert (kind, name) == ("find-pkg-share", "mobo_tuner"), text
            for file in re.findall(r"\$\(find-pkg-share mobo_tuner\)/config/(\S+)", text):
                assert (CONFIG / file).is_file()
    assert used == arguments
    for node in root.iter("node"):
        specs = EXECUTABLES[node.attrib["pkg"], node.attrib["exec"]]
        assert node.attrib["namespace"] == "$(var namespace)"
        known = {spec.name for spec in specs} | {"use_sim_time"}
        flag, *words = SUBSTITUTION.sub(r"\2", node.attrib["args"]).split()
        assert flag == "--ros-args"
        assert words[::2] == ["-p"] * (len(words) // 2)
        given = [word.partition(":=")[0] for word in words[1::2]]
        given += [param.attrib["name"] for param in node.iter("param") if "name" in param.attrib]
        assert given
        assert {*given} <= known


def commands(path: Path, **given: str) -> list[list[str]]:
    """The command lines that launch makes of a file's nodes, without the executable."""
    root = root_of(path)
    values = {arg.attrib["name"]: arg.attrib.get("default", "") for arg in root.iter("arg")}
    values |= given

    def expanded(text: str) -> str:
        text = text.replace("$(find-pkg-share mobo_tuner)/config", str(CONFIG))
        return SUBSTITUTION.sub(lambda found: expanded(values[found[2]]), text)

    lines = []
    for node in root.iter("node"):
        if expanded(node.attrib.get("if", "true")) != "true":
            continue
        line = [
            "-m",
            MODULES[node.attrib["exec"]],
            *map(expanded, node.attrib["args"].split(" -p ")),
        ]
        line = [word for part in line for word in (("-p", part) if ":=" in part else (part,))]
        line += ["--ros-args", "-r", f"__ns:=/{expanded(node.attrib['namespace'])}"]
        for param in node.iter("param"):
            if "from" in param.attrib:
                line += ["--params-file", expanded(param.attrib["from"])]
            else:
                line += ["-p", f"{param.attrib['name']}:={expanded(param.attrib['value'])}"]
        lines.append(line)
    return lines


@pytest.mark.usefixtures("ros_domain")
def test_what_is_launched_comes_up_in_its_namespace(
    start_node: NodeStarter, tmp_path: Path
) -> None:
    by_name = {path.name: path for path in FILES}
    toy = {"namespace": "A", "config": str(CONFIG / "toy.yaml")}
    lines = [
        *commands(by_name["awa_sim.launch.xml"], **toy),
        *commands(
            by_name["tune.launch.xml"],
            **toy,
            runs_dir=str(tmp_path / "my runs"),
            record="true",
            bag_path=str(tmp_path / "bag"),
            run="true",
            evaluations="3",
        ),
        *commands(
            by_name["machine_bridge.launch.xml"],
            namespace="B",
            mapping=str(CONFIG / "bridge_foreign.yaml"),
            autostart="false",
        ),
    ]
    simulator, tuner, recorder, console, bridge = [start_node(*line) for line in lines]
    assert console.wait(60.0) == 0, console.stderr
    assert len(list((tmp_path / "my runs").glob("*/journal.jsonl"))) == 1
    assert "serves /A/evaluate_setpoint" in simulator.stderr
    assert "by the action /A/tune" in tuner.stderr
    assert "ready" in recorder.stderr
    assert bridge.running
    assert "ready" not in bridge.stderr  # it waits for a lifecycle manager
    for process in (tuner, recorder, simulator, bridge):
        assert process.stop() == 0


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_a_launch_file_is_installed(path: Path) -> None:
    setup = (path.parents[1] / "setup.py").read_text(encoding="utf-8")
    assert '(f"share/{NAME}/launch", sorted(glob("launch/*.launch.xml")))' in setup
    manifest = ElementTree.parse(path.parents[1] / "package.xml")
    declared = {e.text for e in manifest.iter("exec_depend")}
    assert {"launch_xml", "launch_ros"} <= declared
    share = Path(sys.prefix) / "share" / path.parents[1].name
    assert (share / "package.xml").exists()


def test_the_analyzers_take_every_status() -> None:
    content = yaml.safe_load((CONFIG / "analyzers.yaml").read_text(encoding="utf-8"))
    parameters = content["analyzers"]["ros__parameters"]
    groups = {name: group for name, group in parameters.items() if isinstance(group, dict)}
    assert {group["type"] for group in groups.values()} == {"diagnostic_aggregator/GenericAnalyzer"}
    statuses = {
        "tuner": ["tuner: run", "A/tuner: machine", "tuner2: run"],
        "machine": ["machine_bridge: interlocks", "A/awa_sim: machine", "my_machine: variables"],
        "recorder": ["recorder: bag", "A/recorder: bag"],
    }
    for group, names in statuses.items():
        for name in names:
            taken = [g for g, rule in groups.items() if any(p in name for p in rule["contains"])]
            assert taken == [group], name
