"""Words for people that depend on numbers."""

from __future__ import annotations


def counted(count: float, noun: str, plural: str = "") -> str:
    """Return a number with its noun, in the singular or the plural.

    Args:
        count: Number of things.
        noun: Noun in the singular.
        plural: Its plural, unless that only adds an s.

    Example:
        >>> counted(1, "change"), counted(3, "change"), counted(0, "diagnosis", "diagnoses")
        ('1 change', '3 changes', '0 diagnoses')
    """
    return f"{count:g} {noun if count == 1 else plural or noun + 's'}"
