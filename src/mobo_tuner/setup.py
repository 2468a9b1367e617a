"""Packaging of mobo_tuner, for pip and for colcon (ament_python)."""

import sys
from glob import glob

from setuptools import find_packages, setup

NAME = "mobo_tuner"
EXECUTABLES = ("console", "machine_bridge", "recorder", "steer", "tuner")

data_files = [
    ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
    (f"share/{NAME}", ["package.xml"]),
    (f"share/{NAME}/config", sorted(glob("../../config/*.yaml"))),
]
if "bdist_wheel" in sys.argv:  # colcon puts the executables there by setup.cfg, pip does not
    data_files.append((f"lib/{NAME}", [f"wrappers/{name}" for name in EXECUTABLES]))

setup(
    name=NAME,
    version="0.1.0",
    description="Multi-objective Bayesian tuning of a running machine, with ROS 2 nodes around it.",
    maintainer="The mobo developers",
    maintainer_email="mobo-ros@users.noreply.github.com",
    license="Apache-2.0",
    python_requires=">=3.11",
    # rclpy and the message packages come with ROS, or from requirements.txt.
    install_requires=[
        "PyYAML",
        "matplotlib",
        "numba",
        "numpy",
        "rich",
        "rosbags",
        "scipy",
        "threadpoolctl",
    ],
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed"]},
    data_files=data_files,
    entry_points={
        "console_scripts": [f"{name} = {NAME}.nodes.{name}:main" for name in EXECUTABLES]
    },
    zip_safe=False,
)
