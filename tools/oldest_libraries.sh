#!/usr/bin/env bash
# Runs a selection of the tests with the oldest libraries that the packages allow, in a virtual environment that is made for
# the purpose and removed afterwards: the core, the machine's side, the report, and runs over ROS with their record. The
# compiled interfaces are those of .venv, and so are the versions of everything else.
set -euo pipefail

root=$(cd "$(dirname "$0")/.." && pwd)
work=$(mktemp -d -t mobo-oldest-XXXXXX)
trap 'rm -rf "$work"' EXIT
for name in $(compgen -e | grep -E '^(PYTHON|ROS_|RMW_|AMENT_|COLCON_|CMAKE_PREFIX_PATH)' || true); do
  unset "$name"
done
unset LD_LIBRARY_PATH _ROS_WHEELS_BOOTSTRAP_COMPLETE

echo "oldest libraries: making a virtual environment"
"$root/.venv/bin/python" -m venv "$work/venv"
python=$work/venv/bin/python
"$python" - "$root" > "$work/requirements.txt" <<'PYTHON'
import re
import sys
from pathlib import Path


def pins(name):
    """Return the lines of a file of requirements by package."""
    lines = Path(sys.argv[1], name).read_text(encoding="utf-8").splitlines()
    return {re.split(r"[\[=]", line)[0]: line for line in lines if re.match(r"\w", line)}


tools = {"pytest", "pytest-timeout", "hypothesis", "iniconfig", "pluggy", "sortedcontainers"}
development = {name: line for name, line in pins("requirements-dev.txt").items() if name in tools}
print(*{**pins("requirements.txt"), **pins("requirements-oldest.txt"), **development}.values(), sep="\n")
PYTHON
"$python" -m pip install --quiet --disable-pip-version-check --no-input -r "$work/requirements.txt"
"$root/.venv/bin/python" - "$work/venv" <<'PYTHON'
import shutil
import sys
import sysconfig
from importlib.metadata import files
from pathlib import Path

packages = Path(sysconfig.get_path("purelib", vars={"base": sys.argv[1]}))
for file in files("mobo_msgs_py"):
    target = packages / file
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copy2(file.locate(), target)
PYTHON

echo "oldest libraries: testing"
cd "$root"
# The libraries themselves use what later versions of others call deprecated.
PYTHONPATH="$root/src/mobo_tuner:$root/src/awa_sim_node" OMP_NUM_THREADS=1 "$python" -m pytest -q -p no:cacheprovider \
  --disable-warnings -o filterwarnings=default \
  tests/core/test_acquisition.py tests/core/test_box_sums.py tests/core/test_derived.py tests/core/test_kernels.py \
  tests/core/test_optimizer_inputs.py tests/core/test_presets.py \
  tests/awa_sim_node/machine tests/machine/test_node.py tests/machine/test_simple.py \
  tests/runs/report/test_command.py tests/runs/report/test_summary.py tests/runs/test_replay.py \
  tests/nodes/test_namespaces.py::test_two_suites_live_in_one_domain_with_one_file \
  tests/nodes/test_tuner.py::test_a_goal_tunes_the_machine_and_everyone_hears_of_it
