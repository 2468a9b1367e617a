"""Packaging of awa_sim_node, for pip and for colcon (ament_python)."""

import sys
from glob import glob

from setuptools import find_packages, setup

NAME = "awa_sim_node"

data_files = [
    ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
    (f"share/{NAME}", ["package.xml"]),
    (f"share/{NAME}/launch", sorted(glob("launch/*.launch.xml"))),
]
if "bdist_wheel" in sys.argv:  # colcon puts the executable there by setup.cfg, pip does not
    data_files.append((f"lib/{NAME}", ["wrappers/awa_sim"]))

setup(
    name=NAME,
    version="1.0.0",
    description="A simulated machine to tune: the AWA injector, or a toy problem.",
    maintainer="The mobo developers",
    maintainer_email="mobo-ros@users.noreply.github.com",
    license="Apache-2.0",
    python_requires=">=3.11",
    # rclpy and the message packages come with ROS, or from requirements.txt.
    install_requires=["mobo_tuner", "numpy>=1.26"],
    # The node needs none of them: the simulation makes the data set that the surrogate is trained on.
    extras_require={
        "simulation": ["numba>=0.58", "scipy>=1.11"],
        "training": ["scipy>=1.11", "torch>=2.1"],
        "test": ["pytest"],
    },
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={
        NAME: ["py.typed"],
        f"{NAME}.simulation": ["*.json"],
        f"{NAME}.surrogate": ["*.json", "*.npz", "*.csv", "DATA_CARD.md"],
    },
    data_files=data_files,
    entry_points={"console_scripts": [f"awa_sim = {NAME}.node:main"]},
    zip_safe=False,
)
