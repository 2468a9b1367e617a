"""The changes of the project that docs/extending.md shows, made in a copy of it."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
MANUAL = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
COPIED = ("config", "docs", "launcher", "robustness", "src", "tools", "mobo.py")

TOPIC = """
import rclpy
from mobo_msgs_py import msg
from mobo_tuner.core import Problem
from mobo_tuner.ros import interfaces
from mobo_tuner.tuner.topics import TunerTopics

rclpy.init()
node = rclpy.create_node("tuner")
topics = TunerTopics(node, Problem.from_yaml("config/toy.yaml"), 0.0)
sizes = []
interfaces.FRONT_SIZE.subscription(node, lambda message: sizes.append(message.data))
topics.front(msg.ParetoFront(points=[msg.ParetoPoint(), msg.ParetoPoint()]))
for _ in range(200):
    rclpy.spin_once(node, timeout_sec=0.05)
    if sizes:
        break
assert sizes == [2.0], sizes
"""

# The changed message is not compiled: its class is made from its definition, as a reader of bags does.
FIELD = """
import sys
from pathlib import Path
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from mobo_tuner.runs import records
from robustness.offline_run import OfflineRun, toy, toy_optimizer

offline = OfflineRun(Path(sys.argv[1]), toy_optimizer(1), toy, seed=1, events=False)
for _ in range(6):
    offline.step()
problem, record = offline.run.records[-1]
assert record.front_size == len(offline.run.found.front) > 1
content = records.to_json(record)
assert content["front_size"] == record.front_size
assert records.from_json(content) == record
del content["front_size"]
assert records.from_json(content).front_size == 0

store = get_typestore(Stores.ROS2_JAZZY)
for name in ("NamedValue", "Evaluation"):
    text = Path(f"src/mobo_msgs_py/msg/{name}.msg").read_text()
    store.register(get_types_from_msg(text, f"mobo_msgs_py/msg/{name}"))
names = ("mobo_msgs_py/msg/Evaluation", "mobo_msgs_py/msg/NamedValue")
names += ("std_msgs/msg/Header", "builtin_interfaces/msg/Time")
classes = [store.types[name] for name in names]

class Named:
    # rclpy has a default for each field, the classes of rosbags have none.
    def __new__(cls, **fields):
        return classes[1](**fields)

def header(stamp):
    return classes[2](stamp=stamp, frame_id="")

made = records.MessageClasses(classes[0], Named, header, classes[3])
message = records.to_message(record, problem, "run", made)
assert message.front_size == record.front_size
assert records.from_message(message).front_size == record.front_size
"""


def apply(folder: Path, diff: str) -> None:
    """Change files as a diff says; the lines before and after a change must occur once."""
    for change in re.split(r"^--- ", diff, flags=re.MULTILINE)[1:]:
        name, _, body = change.partition("\n")
        path = folder / name
        for hunk in body.split("@@\n"):
            lines = hunk.splitlines(keepends=True)
            before = "".join(line[1:] for line in lines if line[0] != "+")
            after = "".join(line[1:] or "\n" for line in lines if line[0] != "-")
            text = path.read_text(encoding="utf-8")
            assert f"\n{text}".count(f"\n{before}") == 1, f"{name} has not once:\n{before}"
            path.write_text(text.replace(before, after), encoding="utf-8")


@pytest.fixture
def changed(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A copy of the project with one change of the manual."""
    [diff] = re.findall(rf"^```diff {request.param}\n(.*?)^```", MANUAL, re.MULTILINE | re.DOTALL)
    for name in COPIED:
        if (ROOT / name).is_symlink():
            (tmp_path / name).symlink_to((ROOT / name).readlink())
        elif (ROOT / name).is_dir():
            ignored = shutil.ignore_patterns("__pycache__", "build", "*.csv", "images")
            shutil.copytree(ROOT / name, tmp_path / name, ignore=ignored)
        else:
            shutil.copy(ROOT / name, tmp_path / name)
    apply(tmp_path, diff)
    return tmp_path


def run(folder: Path, *arguments: str) -> str:
    """Run Python in the copy, with the copy's packages; return what it prints."""
    packages = (folder, folder / "src" / "mobo_tuner", folder / "src" / "awa_sim_node")
    done = subprocess.run(
        [sys.executable, *arguments],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(map(str, packages))},
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("changed", ["verb"], indirect=True)
def test_a_verb_of_ones_own(changed: Path) -> None:
    folder = changed / "runs" / "first"
    folder.mkdir(parents=True)
    (folder / "run.json").write_text("{}")
    assert run(changed, "mobo.py", "where", "first").strip() == str(folder)
    assert "print the folder of a run" in run(changed, "mobo.py", "--help")


@pytest.mark.usefixtures("ros_domain")
@pytest.mark.parametrize("changed", ["topic"], indirect=True)
def test_a_topic_of_ones_own(changed: Path) -> None:
    run(changed, "-c", TOPIC)
    run(changed, "tools/generate_docs.py")
    assert "| `front_size` |" in (changed / "docs" / "interfaces.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("changed", ["field"], indirect=True)
def test_a_field_of_an_evaluation_of_ones_own(changed: Path) -> None:
    run(changed, "-c", FIELD, str(changed / "run"))
