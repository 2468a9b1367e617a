"""The kinds of things that the beam feels, which decide how they move, jitter and drift."""

from enum import StrEnum


class Kind(StrEnum):
    """What an input of a model is."""

    SOLENOID = "solenoid"
    PHASE = "phase"
    GRADIENT = "gradient"
    CHARGE = "charge"
    FIXED = "fixed"  # neither moves nor changes of itself
    EXACT = "exact"  # moves at once, and is where it was told to be
