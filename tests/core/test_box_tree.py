"""Packing; the rest is tested through the hypervolume."""

from __future__ import annotations

import numpy as np
import pytest

from mobo_tuner.core import box_tree
from mobo_tuner.core.hypervolume import BoxDecomposition


@pytest.mark.parametrize("n_objectives", [1, 2, 5])
def test_a_packed_tree_has_neither_dead_ends_nor_single_ways(n_objectives: int) -> None:
    points = np.random.default_rng(n_objectives).random((120, n_objectives))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    for n in (1, 2, 120):
        decomposition = BoxDecomposition(np.full(n_objectives, 1.1), points[:n])
        tree, n_nodes = decomposition._tree, decomposition._n_nodes
        n_boxes = box_tree.count_boxes(tree, n_nodes)
        inner = tree.first_child[1:n_nodes] != box_tree.LEAF
        assert n_boxes[0] == decomposition.n_boxes == np.count_nonzero(~inner)
        assert (n_boxes > 0).all()
        assert (tree.n_children[1:n_nodes][inner] >= 2).all()
