"""Physical constants, and the version of the simulation."""

from __future__ import annotations

from typing import Final

VERSION: Final = "1"
"""Version of the simulation, part of every row of data.

It changes whenever the same settings would give a different beam.
"""

SPEED_OF_LIGHT: Final = 299_792_458.0  # m/s
ELEMENTARY_CHARGE: Final = 1.602176634e-19  # C
ELECTRON_MASS: Final = 9.1093837015e-31  # kg
ELECTRON_REST_ENERGY: Final = 0.51099895  # MeV
VACUUM_PERMITTIVITY: Final = 8.8541878128e-12  # F/m
CHARGE_OVER_MASS: Final = -ELEMENTARY_CHARGE / ELECTRON_MASS  # of the electron, C/kg
