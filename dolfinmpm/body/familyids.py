"""Numbers of points that split: the number of a child tells its parent, its level and its place.

The lower `ROOT_BITS` bits of a number are the number of the first ancestor. The upper bits count
c − 1. In binary, c is a 1, followed by d bits per level: the place of a child among its siblings.
A point that has never split has c = 1, so that its number is that of its ancestor. Families need
no other record: numbers go with the points to other ranks and into checkpoints. They do not depend
on the ranks, or on the order in which points split.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
import numpy.typing as npt

__all__ = [
    "MERGES", "MOST_ROOTS", "ROOT_BITS", "SPLITS", "ancestors_of", "children_of", "deepest",
    "levels_of", "parents_of", "places_of", "side_signs",
]  # fmt: skip

Numbers = npt.NDArray[np.int64]

ROOT_BITS = 38
MOST_ROOTS = 1 << ROOT_BITS
_CODE_BITS = 63 - ROOT_BITS
# On leaves a point splits if its domain is larger than this share of its part of a leaf, and
# siblings merge if their parent's domain is smaller than the second share
SPLITS, MERGES = math.sqrt(2.0), 1.1


def side_signs(gdim: int) -> npt.NDArray[np.float64]:
    """Sides of the parent's centre on which its children lie (-), shape (2^gdim, gdim)."""
    return np.array(list(itertools.product((-1.0, 1.0), repeat=gdim)))


def deepest(gdim: int) -> int:
    """The largest level that a number can tell: 8 in three dimensions, 12 in two."""
    return (_CODE_BITS - 1) // gdim


def ancestors_of(ids: Numbers) -> Numbers:
    """Numbers of the first ancestors."""
    return ids & (MOST_ROOTS - 1)


def levels_of(ids: Numbers, gdim: int) -> Numbers:
    """How often points have split to give each point."""
    return (np.frexp(_codes(ids).astype(float))[1].astype(np.int64) - 1) // gdim


def places_of(ids: Numbers, gdim: int) -> Numbers:
    """Places of the points among their siblings, rows of `side_signs`; for levels above 0."""
    return _codes(ids) & ((1 << gdim) - 1)


def parents_of(ids: Numbers, gdim: int) -> Numbers:
    """Numbers of the points that split; for levels above 0."""
    return ((_codes(ids) >> gdim) - 1 << ROOT_BITS) | ancestors_of(ids)


def children_of(ids: Numbers, places: Numbers, gdim: int) -> Numbers:
    """Numbers of the children at some places; for levels below `deepest`."""
    return (((_codes(ids) << gdim) | places) - 1 << ROOT_BITS) | ancestors_of(ids)


def _codes(ids: Numbers) -> Numbers:
    return (ids >> ROOT_BITS) + 1
