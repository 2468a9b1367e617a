"""Sections of a parameter file, checked before any node runs."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from mobo_tuner.errors import ParameterError
from mobo_tuner.parameter_spec import ParameterSpec, unknown


def node_sections(content: Mapping[Any, Any]) -> dict[str, dict[str, Any]]:
    """Return the parameters of each node in a parameter file, by the node's name.

    The section ``/**``, which is for all nodes, is left out. ``tuner``, ``/tuner`` and ``/**/tuner``
    all are sections of the node ``tuner``.

    Raises:
        ParameterError: If a section does not hold ``ros__parameters`` alone.
    """
    sections: dict[str, dict[str, Any]] = {}
    for key, section in content.items():
        if key == "/**":
            continue
        if not isinstance(section, Mapping) or list(section) != ["ros__parameters"]:
            raise ParameterError(
                f"the section '{key}' must hold 'ros__parameters' and nothing else"
            )
        parameters = section["ros__parameters"]
        if not isinstance(parameters, Mapping):
            raise ParameterError(f"'ros__parameters' of the section '{key}' must be a mapping")
        name = str(key).removeprefix("/**").removeprefix("/")
        sections.setdefault(name, {}).update(parameters)
    return sections


def check_section_names(
    sections: Mapping[str, object], known: Sequence[str], allow_others: bool
) -> None:
    """Reject sections of unknown nodes.

    Args:
        sections: Sections by the node's name.
        known: Names of nodes.
        allow_others: Whether sections of other nodes are allowed, unless their names are similar to known ones.

    Raises:
        ParameterError: If a section is unknown, or an allowed one is similar to a known name.
    """
    for name in sections:
        if name in known:
            continue
        if not allow_others:
            raise ParameterError(
                f"the section '{name}' is unknown; allowed are /**, {', '.join(known)}"
            )
        near = difflib.get_close_matches(name, known, n=1, cutoff=0.8)
        if near:
            raise ParameterError(f"the section '{name}' is unknown; did you mean '{near[0]}'?")


def flat(section: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the parameters of a section with their ROS names, which have a dot per nested mapping."""
    for name, value in section.items():
        if isinstance(value, Mapping) and value:
            yield from flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def check_section(
    where: str, section: Mapping[str, Any], specs: Sequence[ParameterSpec]
) -> dict[str, Any]:
    """Check one node's parameters in a file, and fill in the defaults.

    Args:
        where: Name of the section.
        section: Parameters; those in a mapping have its name and a dot before theirs.
        specs: Parameters of the node.

    Raises:
        ParameterError: If a parameter is unknown, of another type or not allowed.
    """
    given = dict(flat(section))
    known = [spec.name for spec in specs]
    for name in given:
        if name not in known and name != "use_sim_time":
            raise ParameterError(unknown(name, known, where))
    return {
        spec.name: spec.check(given.get(spec.name, spec.default), f"{where}.") for spec in specs
    }
