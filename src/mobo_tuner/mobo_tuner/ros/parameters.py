"""Parameters of nodes: given by files and the command line, declared as they are specified."""

from __future__ import annotations

import difflib
import math
import os
import re
import sys
import tempfile
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from itertools import pairwise
from typing import Any

import yaml
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.exceptions import NameValidationException
from rclpy.node import Node
from rclpy.validate_namespace import validate_namespace
from rclpy.validate_node_name import validate_node_name

from mobo_tuner.errors import ParameterError
from mobo_tuner.files import load_value, load_yaml
from mobo_tuner.parameter_file import flat
from mobo_tuner.parameter_spec import ParameterSpec, unknown

EVERY_NODE = "/**"
"""Section of a parameter file that all nodes take."""
_OF_ROS = ("use_sim_time", "start_type_description_service")
_GAPS: tuple[object, ...] = (None, {}, [])
HIGHEST_DOMAIN = 232
"""Highest ROS domain, beyond which there are no UDP ports."""
_NEARLY = 0.8  # similarity above which a name counts as another one misspelt


def check_domain(domain_id: int | None = None) -> None:
    """Check a ROS domain, of which ROS says neither name nor value, or ends the process.

    Args:
        domain_id: Domain; None for that of the environment.

    Raises:
        ParameterError: If there is no such domain.
    """
    name = "ROS_DOMAIN_ID" if domain_id is None else "domain_id"
    text = os.environ.get(name, "") if domain_id is None else str(domain_id)
    if text and not (text.isdecimal() and len(text) < 4 and int(text) <= HIGHEST_DOMAIN):
        raise ParameterError(
            f"{name} is '{text}'; an integer from 0 to {HIGHEST_DOMAIN} is allowed"
        )


@contextmanager
def as_node_arguments(arguments: Sequence[str], name: str = "") -> Iterator[list[str]]:
    """Yield the command line of a program with one node, as rclpy must get it.

    It differs in five ways. What has no value in a file is left out, whereas ROS refuses the file or
    the node. Scalars and aliases mean what they mean to every other reader of the file: ROS refuses
    aliases, and reads the unit `N` as false. Parameters below a key with a dot keep their names, which ROS mixes up. A
    `-p name:=value` wins over every section of the parameter files, whereas
    ROS lets it yield to the section of the node. And a node that is renamed or in a namespace takes
    the section of its original name in each file without a section of its own but `/**`, whereas ROS
    ignores that section.

    Args:
        arguments: Command line of the node's process.
        name: Name of the node, unless it is renamed.

    Raises:
        ParameterError: If the node's name, namespace or domain is not allowed, or if a section of a file
            has nearly the node's name, and none has it.
    """
    check_domain()
    node = _full_name(arguments, name)
    _refuse_misspelt_sections(arguments, name, node)
    with ExitStack() as files:
        words = list(arguments)
        for position, (flag, path) in enumerate(pairwise(arguments), start=1):
            if flag == "--params-file":
                filled = {key: _filled(section) for key, section in _content(path).items()}
                content = _with_plain_keys(_with_own_section(filled, name, node))
                words[position] = _temporary(_as_text(content), files)
        given = _assigned(arguments, {name, node, node.rpartition("/")[2]} - {""})
        if given:
            values = {key: load_value(text) for key, text in given.items()}
            text = _as_text({"/**/*": {"ros__parameters": values}})
            words += ["--ros-args", "--params-file", _temporary(text, files)]
        yield words


def _full_name(arguments: Sequence[str], name: str) -> str:
    """Return the full name that a node has after remapping.

    Raises:
        ParameterError: If ROS does not allow it.
    """
    namespace = "/"
    for flag, text in pairwise(arguments):
        rule, assigned, value = text.partition(":=")
        if flag in ("-r", "--remap") and assigned and rule.partition(":")[0] in (rule, name):
            match rule.rpartition(":")[2]:
                case "__ns":
                    namespace = value
                case "__node" | "__name":
                    name = value
    for what, given, validate in (
        ("namespace", namespace, validate_namespace),
        ("node name", name or "unnamed", validate_node_name),
    ):
        try:
            validate(given)
        except NameValidationException as error:
            _, reason, *_ = str(error).partition("\n")[0].split(": ")
            raise ParameterError(
                f"the {what} '{given}' is not allowed: {reason.removesuffix(':')}"
            ) from None
    return f"/{namespace.strip('/')}/{name}".replace("//", "/")


def _assigned(arguments: Sequence[str], names: Collection[str]) -> dict[str, str]:
    """Return what `-p` gives to a node, as text; `names` are those by which a `-p` may name it."""
    given = {}
    for flag, text in pairwise(arguments):
        key, assigned, value = text.partition(":=")
        node, _, parameter = key.rpartition(":")
        if (
            flag in ("-p", "--param")
            and assigned
            and "\n" not in value
            and (not node or node in names)
        ):
            given[parameter] = value
    return given


def _refuse_misspelt_sections(arguments: Sequence[str], name: str, node: str) -> None:
    names = {name, node.rpartition("/")[2]} - {""}
    for flag, path in pairwise(arguments):
        sections = [*_content(path)] if flag == "--params-file" else []
        last = {str(section).rpartition("/")[2]: section for section in sections}
        if names & last.keys():
            continue
        for meant in sorted(names):
            # The section `tuner2` is that of a second tuner.
            others = [other for other in last if other.rstrip("_0123456789") != meant]
            if near := difflib.get_close_matches(meant, others, n=1, cutoff=_NEARLY):
                raise ParameterError(
                    f"the section '{last[near[0]]}' of '{path}' is for no node of that name: did you mean "
                    f"'{meant}'?"
                )


def _filled(entry: Any, depth: int = 0) -> Any:
    """Return a section without entries that have no value; `depth` counts the mappings above it.

    ROS knows the name of a quantity, as in `observables: {x: {}}`, only by an entry below it: the one
    that all quantities can have is the unit.
    """
    if not isinstance(entry, Mapping):
        return entry
    inside = {key: _filled(value, depth + 1) for key, value in entry.items()}
    if depth == 2:
        return {key: value if value not in _GAPS else {"unit": ""} for key, value in inside.items()}
    if depth == 0:
        return inside
    return {key: value for key, value in inside.items() if value not in _GAPS}


def _with_own_section(content: Mapping[Any, Any], name: str, node: str) -> Mapping[Any, Any]:
    """Rename the section of a node's original name to its full name, if there is none for that."""
    if not name or node == f"/{name}":
        return content
    if any(section != EVERY_NODE and _is_for(section, node) for section in content):
        return content
    own = {name, f"/{name}", f"/**/{name}"}
    return {node if section in own else section: part for section, part in content.items()}


def _with_plain_keys(content: Mapping[Any, Any]) -> Mapping[Any, Any]:
    """Give all parameters by their ROS names if a key with a dot holds a mapping.

    The parser of ROS forgets such a key only up to its last dot.
    """
    if not _has_dotted_mapping(content):
        return content
    return {
        section: {"ros__parameters": dict(flat(part["ros__parameters"]))}
        for section, part in content.items()
        if isinstance(part, Mapping) and isinstance(part.get("ros__parameters"), Mapping)
    }


def _has_dotted_mapping(content: Mapping[Any, Any]) -> bool:
    """Return whether a key with a dot holds a mapping, at any depth."""
    return any(
        isinstance(value, Mapping) and ("." in str(key) or _has_dotted_mapping(value))
        for key, value in content.items()
    )


def _content(path: str) -> Mapping[Any, Any]:
    """Return what a parameter file holds.

    Raises:
        FileError: If it cannot be read, which rclpy would say in other words.
    """
    return load_yaml(path)


def _is_for(section: object, node: str) -> bool:
    """Return whether a section of a parameter file is for a node, by the rules of ROS."""
    pattern = re.escape(f"/{str(section).removeprefix('/')}")
    for wildcard, meaning in ((r"/\*\*", r"(/\w+)*"), (r"/\*", r"/\w+")):
        pattern = pattern.replace(wildcard, meaning)
    return re.fullmatch(pattern, node) is not None


class _Dumper(yaml.SafeDumper):
    """Writer of YAML in which texts are quoted, and nothing is an alias."""

    def ignore_aliases(self, _data: Any) -> bool:
        """Write a value as often as it stands."""
        return True


_Dumper.add_representer(
    str, lambda dumper, text: dumper.represent_scalar("tag:yaml.org,2002:str", text, style='"')
)


def _as_text(content: Mapping[Any, Any]) -> str:
    """Return what a parameter file holds as ROS reads it."""
    text: str = yaml.dump(
        content, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=math.inf
    )
    return text


def _temporary(text: str, files: ExitStack) -> str:
    """Return the path of a file with a text; it exists until the stack is closed."""
    file = files.enter_context(
        tempfile.NamedTemporaryFile("w", suffix=".yaml", encoding="utf-8")  # noqa: SIM115
    )
    file.write(text)
    file.flush()
    return file.name


def given_parameters(node: Node) -> dict[str, Any]:
    """Return the parameters of a node that declares them from its files and command line."""
    declared: Mapping[str, Any] = node.get_parameters_by_prefix("")
    return {
        name: parameter.value
        for name, parameter in declared.items()
        if name not in _OF_ROS and not name.startswith("qos_overrides.")
    }


def take_given(node: Node) -> list[str]:
    """Return the names of a node's parameters that were given, and leave them to be declared.

    The node must have declared them from its files and command line; when it declares one again, it
    gets the value that was given.
    """
    names = list(given_parameters(node))
    for name in names:
        node.undeclare_parameter(name)
    return names


def refuse_undeclared(node: Node, given: Iterable[str], *, misspelt: bool = False) -> None:
    """Refuse given parameters that a node did not declare, of which ROS says nothing.

    What stands in the section for every node of a parameter file may be another node's. It is refused
    only if it is nearly the name of one of this node's parameters.

    Args:
        node: Node that has declared its parameters.
        given: Names that `take_given` returned.
        misspelt: Whether only those are refused that are nearly the name of a parameter.

    Raises:
        ParameterError: If a parameter is unknown.
    """
    known = list(given_parameters(node))
    common = {
        name
        for word, path in pairwise(sys.argv)
        if word == "--params-file"
        for name in _common_names(_content(path))
    }
    for name in given:
        if node.has_parameter(name):
            continue
        if not (misspelt or name in common) or difflib.get_close_matches(
            name, known, n=1, cutoff=_NEARLY
        ):
            raise ParameterError(unknown(name, known, "the node"))


def _common_names(content: Mapping[Any, Any]) -> Iterator[str]:
    """Yield the names of the parameters in the section for every node."""
    section = _filled(content.get(EVERY_NODE))
    parameters = section.get("ros__parameters") if isinstance(section, Mapping) else None
    if isinstance(parameters, Mapping):
        for name, _ in flat(parameters):
            yield name


def refuse_unknown(given: Iterable[str], known: Collection[str]) -> None:
    """Refuse parameters that a node does not have, of which ROS says nothing.

    Args:
        given: Names of the parameters.
        known: Names of the node's parameters and of what its other parameters stand below.

    Raises:
        ParameterError: If one is unknown.
    """
    for name in given:
        first, dot, _ = name.partition(".")
        if name not in known and not (dot and first in known):
            raise ParameterError(unknown(name if name.count(".") < 2 else first, known, "the node"))


def declare(node: Node, specs: Sequence[ParameterSpec]) -> dict[str, Any]:
    """Declare parameters with description and range, and return their values.

    Raises:
        ParameterError: If a value is of another type or not allowed.
    """
    values = {}
    for spec in specs:
        descriptor = ParameterDescriptor(
            name=spec.name,
            description=spec.description,
            additional_constraints=spec.range_text,
            read_only=not spec.writable,
            dynamic_typing=True,  # so that `speed: 100` may stand for 100.0; checked below
        )
        if node.has_parameter(spec.name):
            value = node.get_parameter(spec.name).value
            node.set_descriptor(spec.name, descriptor)
        else:
            default = list(spec.default) if isinstance(spec.default, tuple) else spec.default
            value = node.declare_parameter(spec.name, default, descriptor).value
        values[spec.name] = spec.check(value)
    return values
