"""Kinds of model inputs; the kind decides how an input moves, jitters and drifts."""

from enum import StrEnum


class Kind(StrEnum):
    """Kind of an input of a model."""

    SOLENOID = "solenoid"
    PHASE = "phase"
    GRADIENT = "gradient"
    CHARGE = "charge"
    FIXED = "fixed"  # constant
    EXACT = "exact"  # moves at once and exactly to its set-point
