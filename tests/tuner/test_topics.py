"""How often the tuner publishes a growing front."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from rclpy.node import Node

from mobo_msgs_py import msg
from mobo_tuner.core import Problem
from mobo_tuner.tuner.topics import FRONT_SHARE, TunerTopics

PROBLEM = Problem.from_dict(
    {
        "variables": {"x": {"min": 0.0, "max": 1.0}},
        "objectives": {"f": {"reference": 2.0}, "g": {"reference": 2.0}},
    }
)


def published(node: Node, fronts: Sequence[range]) -> list[int]:
    """Sizes of those fronts that are published."""
    topics = TunerTopics(node, PROBLEM, 0.0)
    sizes = []
    for indices in fronts:

        def make(indices: range = indices) -> msg.ParetoFront:
            sizes.append(len(indices))
            return msg.ParetoFront(points=[msg.ParetoPoint(index=index) for index in indices])

        topics.front_changed(indices, make)
    return sizes


def test_fronts_take_space_in_proportion_to_their_points(node: Node) -> None:
    sizes = published(node, [range(size) for size in range(1, 401)])
    assert sizes[:10] == list(range(1, 11))  # a small front at every change
    assert sum(sizes) < 1.5 * 400 / FRONT_SHARE
    assert all(later <= 1.2 * earlier + 1.0 for earlier, later in itertools.pairwise(sizes))


def test_a_front_that_keeps_its_size_is_published_again_once_a_tenth_is_new(node: Node) -> None:
    sliding = [range(start, start + 100) for start in range(60)]
    assert len(published(node, sliding)) == 1 + 59 // 5  # five leave and five join


def test_a_front_that_is_the_same_is_not_published_again(node: Node) -> None:
    assert published(node, [range(size) for size in (1, 1, 2, 2, 2)]) == [1, 2]
