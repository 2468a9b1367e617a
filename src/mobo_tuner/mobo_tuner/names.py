"""Names of quantities: those of the laboratory's control system, and the topics that stand for them."""

from __future__ import annotations

import hashlib
import re

LONGEST = 200
"""Largest number of characters of a name."""
ALLOWED = (
    f"at most {LONGEST} letters, digits and _ : . / + - are allowed, with a letter among them, a letter or digit first "
    "and none of : . / last; .readback and .stddev are endings of columns in tables"
)
"""What a name may be, in words."""
# The letter keeps names apart from numbers, the ends keep them apart from what surrounds them in a parameter's name.
_NAME = re.compile(r"(?=[^A-Za-z]*[A-Za-z])[A-Za-z0-9]([A-Za-z0-9_:./+-]*[A-Za-z0-9_+-])?")
_NOT_IN_TOPICS = re.compile(r"[^A-Za-z0-9]+")
_LONGEST_TOKEN = 100  # characters, so that a topic in a namespace stays below the limit of ROS


def is_name(name: object) -> bool:
    """Return whether a quantity may have a name.

    Process variables of EPICS, attributes of Tango, addresses of DOOCS and devices of ACNET may.

    Example:
        >>> is_name("LI20:QUAD:Q1:BCTRL"), is_name("sys/tg_test/1/ampli"), is_name("beam size")
        (True, True, False)
    """
    return (
        isinstance(name, str)
        and len(name) <= LONGEST
        and _NAME.fullmatch(name) is not None
        and not name.endswith((".readback", ".stddev"))
    )


def topic_token(name: str) -> str:
    """Return the part of a topic that stands for a name: letters, digits and single underscores.

    Example:
        >>> topic_token("K1"), topic_token("LI20:QUAD:Q1:BCTRL")
        ('K1', 'LI20_QUAD_Q1_BCTRL')
    """
    if "__" not in name and name.isidentifier() and len(name) <= _LONGEST_TOKEN:
        return name
    token = _NOT_IN_TOPICS.sub("_", name).strip("_")
    if len(token) > _LONGEST_TOKEN:
        digest = hashlib.sha256(name.encode()).hexdigest()[:8]
        token = f"{token[: _LONGEST_TOKEN - len(digest) - 1].rstrip('_')}_{digest}"
    return token if token[0].isalpha() else f"n{token}"
