"""Compiled kernels of the box decomposition: a tree of local upper bounds.

The region below the reference point that no point of the front dominates is the union of cones
{z < u} over the local upper bounds u, and it splits into disjoint boxes [l, u), one for each u
`[Lacour2017]_`. Adding a point y replaces every u with y < u by up to P children, each equal to its
parent in all but one objective, where it takes the component of y. The history of these splits is
stored as a tree: the cone of a child lies inside that of its parent, so that whole branches can be
skipped exactly, both when a point is added and when the boxes are summed. Most nodes of the history
are not needed; `pack` removes them, which makes sums several times faster.

Only indices are stored. Row i of `levels` `(k, P)` is a point: rows 0 .. P-1 bound the
objectives at the reference point, row P is minus infinity, the points of the front follow. Box b
then has the upper corner `levels[upper[b, j], j]` and the lower corner `levels[lower[b, j], j]`.

.. [Lacour2017] R. Lacour, K. Klamroth, C. M. Fonseca, "A box decomposition algorithm to compute
   the hypervolume indicator", Computers & Operations Research 79, 347-360 (2017).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.compilation import compiled

IndexArray = NDArray[Any]  # uint16, or uint32 for more than 65 000 points; unsigned is faster

LEAF = 0  # the root is not a child of any node


class BoxTree(NamedTuple):
    """The tree's arrays, with capacity for more nodes than are in use; node 0 is the root.

    Attributes:
        upper: Rows of `levels` with the upper corners `(nodes, P)`.
        lower: Rows of `levels` with the lower corners `(nodes, P)`; used in leaves.
        axis: Objective in which a node differs from its parent, tested first `(nodes,)`.
        first_child: First child of each node `(nodes,)`; children are contiguous and come after
            their parent; `LEAF` marks a box.
        n_children: Number of children `(nodes,)`, 0 to P for an inner node; with 0 it is a dead end.
    """

    upper: IndexArray
    lower: IndexArray
    axis: NDArray[np.uint8]
    first_child: NDArray[np.uint32]
    n_children: NDArray[np.uint8]


@compiled
def _resized(array: NDArray[np.int32], size: int) -> NDArray[np.int32]:
    resized = np.empty(size, np.int32)
    for i in range(min(size, len(array))):  # assigning a slice takes seconds to compile
        resized[i] = array[i]
    return resized


@compiled
def find_leaves(tree: BoxTree, levels: FloatArray, point: FloatArray) -> NDArray[np.int32]:
    """Find the boxes whose upper corner is strictly above `point` `(P,)`, which is below the root.

    Returns:
        The nodes of the boxes `(h,)`.
    """
    n_objectives = levels.shape[1]
    stack = np.empty(1024, np.int32)
    found = np.empty(1024, np.int32)
    stack[0] = 0
    size = 1
    n_found = 0
    while size > 0:
        size -= 1
        node = stack[size]
        first = tree.first_child[node]
        if first == LEAF:
            if n_found == len(found):
                found = _resized(found, 2 * n_found)
            found[n_found] = node
            n_found += 1
            continue
        if size + tree.n_children[node] > len(stack):
            stack = _resized(stack, 2 * len(stack))
        for child in range(first, first + tree.n_children[node]):
            axis = tree.axis[child]
            inside = point[axis] < levels[tree.upper[child, axis], axis]
            for j in range(n_objectives if inside else 0):
                if point[j] >= levels[tree.upper[child, j], j]:
                    inside = False
                    break
            if inside:
                stack[size] = child
                size += 1
    return _resized(found, n_found)


@compiled
def split_leaves(
    tree: BoxTree, levels: FloatArray, leaves: NDArray[np.int32], row: int, n_nodes: int
) -> tuple[int, float]:
    """Split the boxes found for the point in `levels[row]`.

    Ties are broken as if the newest point were larger (`>=` below): with a strict comparison, boxes
    would be lost if points share a component.

    Args:
        tree: Tree, modified in place; needs capacity for P children of every leaf.
        levels: Levels of the tree `(k, P)`.
        leaves: Nodes from `find_leaves` `(h,)`.
        row: Row of the new point in `levels`.
        n_nodes: Number of nodes in use.

    Returns:
        The new number of nodes in use, and the hypervolume gained.
    """
    n_objectives = levels.shape[1]
    point = levels[row]
    gained = 0.0
    for leaf in leaves:
        volume = 1.0
        for j in range(n_objectives):
            below = max(levels[tree.lower[leaf, j], j], point[j])
            volume *= levels[tree.upper[leaf, j], j] - below
        gained += volume
        first = n_nodes
        for axis in range(n_objectives):
            largest = -np.inf
            for k in range(n_objectives):
                if k != axis:
                    largest = max(largest, levels[tree.upper[leaf, k], axis])
            if point[axis] >= largest:
                for k in range(n_objectives):
                    tree.upper[n_nodes, k] = row if k == axis else tree.upper[leaf, k]
                tree.axis[n_nodes] = axis
                tree.first_child[n_nodes] = LEAF
                _set_lower_corner(tree, levels, n_nodes)
                n_nodes += 1
        tree.first_child[leaf] = first
        tree.n_children[leaf] = n_nodes - first
    return n_nodes, gained


@compiled
def _set_lower_corner(tree: BoxTree, levels: FloatArray, node: int) -> None:
    """Set l_j to the largest j-th component of the points that bound the objectives before j."""
    n_objectives = levels.shape[1]
    for j in range(n_objectives):
        best = n_objectives  # the row of minus infinity
        for k in range(j):
            row = tree.upper[node, k]
            if levels[row, j] > levels[best, j]:
                best = row
        tree.lower[node, j] = best


@compiled
def count_boxes(tree: BoxTree, n_nodes: int) -> NDArray[np.int32]:
    """Return the number of boxes below each node, itself included `(n_nodes,)`."""
    n_boxes = np.zeros(n_nodes, np.int32)
    for node in range(n_nodes - 1, -1, -1):
        first = tree.first_child[node]
        if first == LEAF:
            n_boxes[node] = 1
        else:
            for child in range(first, first + tree.n_children[node]):
                n_boxes[node] += n_boxes[child]
    return n_boxes


@compiled
def _skip_single_ways(tree: BoxTree, n_boxes: NDArray[np.int32], node: np.int64) -> np.int64:
    """Descend from a node to the first one whose boxes are in several branches, or to its only box."""
    while tree.first_child[node] != LEAF:
        child = np.int64(tree.first_child[node])
        while n_boxes[child] == 0:
            child += 1
        if n_boxes[child] < n_boxes[node]:
            break
        node = child
    return node


@compiled
def pack(tree: BoxTree, n_boxes: NDArray[np.int32], packed: BoxTree, n_levels: int) -> int:
    """Copy the tree into `packed`, without dead ends and without nodes that have a single branch.

    The nodes are in the order in which a sum visits them, for a good use of caches.

    Args:
        tree: Tree whose root is not a box itself.
        n_boxes: Numbers from `count_boxes`.
        packed: Empty tree with capacity for as many nodes; overwritten.
        n_levels: Number of levels in use.

    Returns:
        The number of nodes in use in `packed`.
    """
    n_objectives = tree.upper.shape[1]
    stack = np.zeros((n_levels * n_objectives, 2), np.int32)
    size = 1
    n_nodes = 1
    while size > 0:
        size -= 1
        node = stack[size, 0]
        place = stack[size, 1]
        packed.first_child[place] = n_nodes
        first = tree.first_child[node]
        for child in range(first, first + tree.n_children[node]):
            if n_boxes[child] == 0:
                continue
            kept = _skip_single_ways(tree, n_boxes, np.int64(child))
            for j in range(n_objectives):
                packed.upper[n_nodes, j] = tree.upper[kept, j]
                packed.lower[n_nodes, j] = tree.lower[kept, j]
            packed.axis[n_nodes] = tree.axis[kept]
            if tree.first_child[kept] != LEAF:
                stack[size, 0] = kept
                stack[size, 1] = n_nodes
                size += 1
            n_nodes += 1
        packed.n_children[place] = n_nodes - packed.first_child[place]
    return n_nodes
