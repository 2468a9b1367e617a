"""Packaging of mobo_tuner, for pip and for colcon (ament_python)."""

import sys
from glob import glob

from setuptools import find_packages, setup

NAME = "mobo_tuner"
EXECUTABLES = ("console", "live_server", "machine_bridge", "page", "recorder", "steer", "tuner")
# Exactly this version of rosbags: runs/bag.py writes MCAP with parts of it that may change.
BAGS = ["backports.zstd>=1.0", "lz4>=4.0", "rosbags==0.11.9"]
# simpleeval before 1.0.5 can be escaped from. The tuner resumes from a bag, too.
TUNER = ["numba>=0.58", "scipy>=1.11", "simpleeval>=1.0.5", "threadpoolctl>=3.1", *BAGS]
EXTRAS = {
    "tuner": TUNER,
    "recorder": BAGS,
    "console": ["rich>=13.7"],
    # Exactly this version of NiceGUI, which is pinned with all that it needs in requirements-page.txt.
    "page": ["nicegui==3.18.0", "fastapi>=0.115", "starlette>=0.45", "uvicorn>=0.34"],
    # Exactly this version: the server sends a late viewer what it missed by numbers that may change.
    "live": ["foxglove-sdk==0.30.3"],
    # Exactly these versions: the interface of generators still moves.
    "offline": [*TUNER, "gest-api==0.2", "libensemble==1.6.1", "rich>=13.7"],
    "export": [*TUNER, "pyarrow>=16"],
    "report": [*TUNER, "Jinja2>=3.1", "MarkupSafe>=2.1", "matplotlib>=3.6", "rich>=13.7"],
}

data_files = [
    ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
    (f"share/{NAME}", ["package.xml"]),
    (f"share/{NAME}/launch", sorted(glob("launch/*.launch.xml"))),
    (f"share/{NAME}/config", sorted(glob("config/*.yaml") + glob("config/*.csv"))),
    (f"share/{NAME}/config/presets", sorted(glob("config/presets/*.yaml"))),
]
if "bdist_wheel" in sys.argv:  # colcon puts the executables there by setup.cfg, pip does not
    data_files.append((f"lib/{NAME}", [f"wrappers/{name}" for name in EXECUTABLES]))

setup(
    name=NAME,
    version="1.0.0",
    description="Multi-objective Bayesian tuning of a running machine, with ROS 2 nodes around it.",
    maintainer="The mobo developers",
    maintainer_email="mobo-ros@users.noreply.github.com",
    license="Apache-2.0",
    python_requires=">=3.11",
    # The machine's side needs these alone: mobo_tuner.machine, .bridge, .ros, machine_bridge. rclpy and
    # the message packages come with ROS, or from requirements.txt. The oldest versions are Ubuntu 24.04's.
    install_requires=["PyYAML>=6.0", "numpy>=1.26"],
    extras_require={
        **EXTRAS,
        "all": sorted({name for extra in EXTRAS.values() for name in extra}),
        "test": ["pytest"],
    },
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed", "page/static/*", "runs/report/templates/*"]},
    data_files=data_files,
    entry_points={
        "console_scripts": [f"{name} = {NAME}.nodes.{name}:main" for name in EXECUTABLES],
        "ros2doctor.checks": [
            f"mobo_machine = {NAME}.ros.doctor:MachineCheck",
            f"mobo_tuner = {NAME}.ros.doctor:TunerCheck",
        ],
        "ros2doctor.report": [f"mobo_tuner = {NAME}.ros.doctor:TunerReport"],
    },
    zip_safe=False,
)
