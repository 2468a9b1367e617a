#!/usr/bin/env bash
# Builds the three packages with colcon, as on a full ROS installation, runs the tests of each with
# `colcon test`, and starts the tuner from what was built. ROS comes from the same wheels as in .venv, in a virtual environment that is made for the
# purpose and removed afterwards, as is all else.
set -euo pipefail

root=$(cd "$(dirname "$0")/.." && pwd)
work=$(mktemp -d -t mobo-colcon-XXXXXX)
trap 'rm -rf "$work"' EXIT
for name in $(compgen -e | grep -E '^(PYTHON|ROS_|RMW_|AMENT_|COLCON_|CMAKE_PREFIX_PATH)' || true); do
  unset "$name"
done
unset LD_LIBRARY_PATH _ROS_WHEELS_BOOTSTRAP_COMPLETE

echo "colcon: making a virtual environment"
python3 -m venv "$work/venv"
export VIRTUAL_ENV=$work/venv PATH=$work/venv/bin:$PATH
cp "$root/requirements.txt" "$work/requirements.txt"
python - "$root/src/mobo_msgs_py/pyproject.toml" >> "$work/requirements.txt" <<'PYTHON'
import sys
import tomllib

with open(sys.argv[1], "rb") as file:
    needed = tomllib.load(file)["build-system"]["requires"]
pinned_already = ("numpy", "lark-parser")
print(*(n for n in needed if not n.startswith(("scikit-build-core", *pinned_already))), sep="\n")
PYTHON
pip install --quiet --disable-pip-version-check --no-input \
  -r "$work/requirements.txt" -r "$root/requirements-colcon.txt"

echo "colcon: building"
mkdir "$work/workspace"
cp -r "$root/src" "$work/workspace"
cd "$work/workspace"
export CMAKE_PREFIX_PATH=$VIRTUAL_ENV AMENT_PREFIX_PATH=$VIRTUAL_ENV
colcon build --base-paths src --event-handlers console_cohesion+ --cmake-args \
  -DBUILD_TESTING=ON -DPython3_EXECUTABLE="$VIRTUAL_ENV/bin/python" \
  -DCMAKE_PROJECT_INCLUDE=cmake/pip_ros.cmake > "$work/build.log" 2>&1 ||
  { tail -n 50 "$work/build.log"; exit 1; }

set +u
source install/setup.bash
set -u

echo "colcon: testing"
colcon test --base-paths src --event-handlers console_direct+ --return-code-on-test-failure \
  > "$work/test.log" 2>&1 || { tail -n 50 "$work/test.log"; exit 1; }
for package in "$work"/workspace/src/*/; do # each has tests, and none was left out
  colcon test-result --test-result-base "build/$(basename "$package")" |
    grep -qE '^Summary: [1-9][0-9]* tests, 0 errors, 0 failures, 0 skipped$' ||
    { echo "colcon: $(basename "$package") has no tests, or not all of them ran"; exit 1; }
done

echo "colcon: starting the tuner"
PYTHONPATH=$PYTHONPATH:$root ROS_LOG_DIR=$work/log timeout 120 python - <<'PYTHON'
import os
import signal
import subprocess
import sys
import time

import rclpy
from launcher.ros_domain import RosDomain

with RosDomain() as domain:
    os.environ |= domain.environment
    tuner = subprocess.Popen(
        ["install/mobo_tuner/lib/mobo_tuner/tuner"]
        + ["--ros-args", "--params-file", "install/mobo_tuner/share/mobo_tuner/config/awa.yaml"]
    )
    try:
        rclpy.init()
        node = rclpy.create_node("visitor")
        deadline = time.monotonic() + 60.0
        while "tuner" not in node.get_node_names():
            if tuner.poll() is not None or time.monotonic() > deadline:
                sys.exit("colcon: the tuner did not come up")
            rclpy.spin_once(node, timeout_sec=0.2)
        tuner.send_signal(signal.SIGINT)
        status = tuner.wait(timeout=10.0)
    finally:
        tuner.kill()
        tuner.wait()
        rclpy.try_shutdown()
    if status != 0:
        sys.exit(f"colcon: the tuner ended with status {status}")
print("colcon: the tuner came up and ended when asked to")
PYTHON
