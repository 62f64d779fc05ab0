"""Parts of a lattice: equal shares of what stands in its cells."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from dolfinmpm.grid.partition import Partition, partition_of


@pytest.mark.parametrize("ranks", [1, 2, 3, 7, 8])
@pytest.mark.parametrize("shape", [(40,), (12, 9), (6, 5, 7)])
def test_shares_are_equal_to_a_cell(shape, ranks):
    rng = np.random.default_rng(len(shape))
    every = np.indices(shape).reshape(len(shape), -1).T
    ijk = every[rng.random(len(every)) < 0.8]
    weights = rng.integers(1, 9, len(ijk)).astype(float)
    parts = partition_of(shape, ranks, ijk, weights)
    shares = np.bincount(parts.rank_of(ijk), weights, minlength=ranks)
    # each cut is off by less than half of the largest cell, and there are log₂ of them in a row
    off = np.abs(shares - weights.sum() / ranks).max()
    assert off <= weights.max() / 2 * np.ceil(np.log2(max(ranks, 2)))
    assert parts.imbalance == pytest.approx(shares.max() * ranks / weights.sum())


def test_every_cell_is_in_one_part():
    ijk, weights = np.array([[0, 0], [0, 1], [3, 2]]), np.array([1.0, 1.0, 5.0])
    parts = partition_of((4, 3), 3, ijk, weights)
    cells = np.concatenate([parts.cells(rank) for rank in range(3)])
    assert sorted(map(tuple, cells)) == sorted(np.ndindex(4, 3))


def test_parts_are_next_to_each_other():
    """Of a block that is cut in two, few cells have a neighbour in the other part."""
    ijk = np.indices((16, 64)).reshape(2, -1).T
    parts = partition_of((16, 80), 2, ijk, np.ones(len(ijk)))
    ranks = np.full((16, 64), -1)
    ranks[tuple(ijk.T)] = parts.rank_of(ijk)
    assert np.count_nonzero(np.diff(ranks, axis=0)) + np.count_nonzero(np.diff(ranks, axis=1)) == 16


def test_more_ranks_than_cells():
    parts = partition_of((2, 2), 5, np.array([[0, 0], [1, 1]]), np.array([3.0, 3.0]))
    shares = np.bincount(parts.rank_of(np.array([[0, 0], [1, 1]])), minlength=5)
    assert shares.max() == 1
    assert parts.imbalance == 2.5


def test_it_can_be_kept_as_text():
    parts = partition_of((5, 5), 3, np.array([[1, 1], [2, 3], [4, 4]]), np.ones(3))
    again = Partition.restored(json.loads(json.dumps(dataclasses.asdict(parts))))
    assert dataclasses.asdict(again) == dataclasses.asdict(parts)
