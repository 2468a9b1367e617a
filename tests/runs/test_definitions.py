"""Message definitions: complete, decodable, and with the hash that ROS itself computes."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mobo_tuner.runs.definitions import DefinitionError, default_prefixes, find_definition

SHARE = Path(sys.prefix) / "share"
TYPES = sorted(
    f"{path.parts[-3]}/msg/{path.stem}"
    for package in ("mobo_msgs_py", "std_msgs", "rcl_interfaces", "diagnostic_msgs")
    for path in (SHARE / package / "msg").glob("*.msg")
    if path.stem != "Char"  # rosbags takes its `char` for a type of its own
)


def test_there_are_types_to_test() -> None:
    assert "mobo_msgs_py/msg/Evaluation" in TYPES


@pytest.mark.parametrize("name", TYPES)
def test_the_definition_is_complete_and_its_hash_right(name: str) -> None:
    definition = find_definition(name)
    main, *used = definition.text.split("=" * 80 + "\n")
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(main, name))
    for part in used:
        head, text = part.split("\n", maxsplit=1)
        package, short_name = head.removeprefix("MSG: ").split("/")
        store.register(get_types_from_msg(text, f"{package}/msg/{short_name}"))
    assert store.hash_rihs01(name) == definition.type_hash
    schema = Schema(id=1, name=name, encoding="ros2msg", data=definition.text.encode())
    assert DecoderFactory().decoder_for("cdr", schema) is not None


@pytest.mark.parametrize(
    "name", ["nowhere/msg/Nothing", "mobo_msgs_py/action/Tune_Feedback", "String", ""]
)
def test_an_unknown_type_is_an_error(name: str) -> None:
    with pytest.raises(DefinitionError, match="is not installed"):
        find_definition(name)


def test_a_damaged_description_is_an_error(tmp_path: Path) -> None:
    folder = tmp_path / "share" / "pkg" / "msg"
    folder.mkdir(parents=True)
    (folder / "Thing.json").write_text("{}")
    with pytest.raises(DefinitionError, match="description of pkg/msg/Thing is damaged"):
        find_definition("pkg/msg/Thing", [tmp_path])


def test_prefixes_come_from_the_environment_first(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AMENT_PREFIX_PATH", "/one:/two")
    assert default_prefixes() == [Path("/one"), Path("/two"), Path(sys.prefix)]
    monkeypatch.delenv("AMENT_PREFIX_PATH")
    assert default_prefixes() == [Path(sys.prefix)]
