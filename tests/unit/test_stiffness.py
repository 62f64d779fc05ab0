"""Sums over the points' stencils into the matrix, and parts of a matrix made one."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from dolfinmpm.assembly.stiffness import stiffness_kernel
from dolfinmpm.cut.merging import one_block_per_pair, summed
from dolfinmpm.cut.pattern import Blocks


def stencils(random, nodes, gdim):
    """Lists of nodes, increasing, of groups of points, and the points' functions."""
    counts, sizes = [3, 5, 1, 4, 6], [2, 1, 4, 1, 3]
    lists = [np.sort(random.choice(np.arange(2, nodes), m, replace=False)) for m in counts]
    groups, node_start = np.r_[0, np.cumsum(sizes)], np.r_[0, np.cumsum(counts)]
    values = np.multiply(counts, sizes)
    value_start = np.r_[0, np.cumsum(values)]
    N, dN = random.random(values.sum()), random.random((values.sum(), gdim))
    groups, node_start = groups.astype(np.int32), node_start.astype(np.int32)
    return lists, (groups, node_start, np.concatenate(lists).astype(np.int32), value_start, N, dN)


@pytest.mark.parametrize("gradient_only", [True, False])
@pytest.mark.parametrize(("nc", "gdim"), [(1, 1), (1, 2), (2, 2), (3, 2), (3, 3), (4, 2)])
def test_a_stiffness_is_the_sum_over_the_points(nc, gdim, gradient_only):
    random, nodes = np.random.default_rng(nc), 14
    ns = gdim if gradient_only else gdim + 1
    lists, s = stencils(random, nodes, gdim)
    groups, node_start, _, value_start, N, dN = s
    T = random.random((groups[-1], nc, ns, nc, ns))
    fixed = random.random((nodes, nc)) < 0.2
    row_of = np.full((nodes, nc), -1, np.int32)
    row_of[~fixed] = np.arange(np.count_nonzero(~fixed))
    rows = np.count_nonzero(~fixed)
    whole = np.zeros((nodes, nc, nodes, nc))
    for g, own in enumerate(lists):
        m = len(own)
        for p in range(groups[g], groups[g + 1]):
            at = slice(*(value_start[g] + (p - groups[g]) * m + np.array([0, m])))
            phi = dN[at] if gradient_only else np.column_stack([N[at], dN[at]])
            K = np.einsum("as,isjr,br->aibj", phi, T[p], phi)
            whole[own[:, None], :, own] += K.transpose(0, 2, 1, 3)
    prescribed = random.random((nodes, nc))
    # what no list couples has no entry
    coupled = np.zeros((nodes, nodes), bool)
    for own in lists:
        coupled[np.ix_(own, own)] = True
    coupled[np.arange(nodes), np.arange(nodes)] = True
    wide = np.repeat(np.repeat(coupled, nc, axis=0), nc, axis=1)
    free = ~fixed.ravel()
    at_rows, indices = np.nonzero(wide[np.ix_(free, free)])
    indptr = np.r_[0, np.cumsum(np.bincount(at_rows, minlength=rows))].astype(np.int32)
    data, lift = np.zeros(indices.size), np.zeros((nodes, nc))
    # in two parts, as the points' tangents come
    for begin, end in ((0, 2), (2, 5)):
        of_points = T[groups[begin] : groups[end]].reshape(-1, (nc * ns) ** 2)
        stiffness_kernel(nc, ns, gradient_only)(
            begin, end, groups, node_start, s[2], value_start, N, dN, of_points, row_of, indptr,
            indices.astype(np.int32), data, prescribed, lift,
        )  # fmt: skip
    dense = whole.reshape(nodes * nc, nodes * nc)
    np.testing.assert_allclose(data, dense[np.ix_(free, free)][at_rows, indices], rtol=1e-12)
    pushed = dense[:, ~free] @ prescribed.ravel()[~free]
    np.testing.assert_allclose(lift.ravel()[free], pushed[free], rtol=1e-12)
    assert not lift.ravel()[~free].any()


def test_sums_of_pairs_are_in_order():
    random = np.random.default_rng(1)
    rows, columns = random.integers(0, 9, (2, 200)).astype(np.int32)
    values = random.random((200, 2, 3))
    dense = np.zeros((9, 9, 2, 3))
    np.add.at(dense, (rows, columns), values)
    a, b, total = summed(rows, columns, values)
    assert (np.diff(9 * a + b) > 0).all()
    assert a.size == np.unique(9 * rows + columns).size
    np.testing.assert_allclose(total, dense[a, b], rtol=1e-13)
    nothing = summed(rows[:0], columns[:0], values[:0])
    assert [n.shape for n in nothing] == [(0,), (0,), (0, 2, 3)]


def test_parts_of_the_same_fields_are_made_one():
    node = np.array([1], np.int32)
    parts = [Blocks(i, j, node, node, np.full((1, 1, 1), v)) for i, j, v in
             ((0, 0, 1.0), (0, 1, 2.0), (0, 0, 4.0))]  # fmt: skip
    one, other = one_block_per_pair(parts)
    assert (one.row_field, one.column_field, one.values.item()) == (0, 0, 5.0)
    assert other is parts[1]
    assert one_block_per_pair([]) == []


BLOCK = """
import numpy as np
from dolfinx import mesh
from mpi4py import MPI
import dolfinmpm as mpm
for d in 2, 3:
    kind = mesh.CellType.quadrilateral if d == 2 else mesh.CellType.hexahedron
    create = mesh.create_rectangle if d == 2 else mesh.create_box
    grid = create(MPI.COMM_WORLD, [(0,) * d, (1,) * d], (3,) * d, kind)
    points = mpm.fill(grid, mpm.Box((0,) * d, (0.9,) * d), 2, 1.0)
    V = mpm.Space(grid)
    F = mpm.momentum(mpm.materials.Hencky(E=1e3, nu=0.3), points, V.increment, V.test)
    problem = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))
    problem.activate()
    print(repr(np.abs(problem.stiffness().getValuesCSR()[2]).sum()))
"""


def test_memory_that_is_free_is_not_read():
    """The C library fills what is freed with a pattern, or leaves it as it was."""
    found = []
    for pattern in ("0", "90"):
        environment = {**os.environ, "MALLOC_PERTURB_": pattern}
        done = subprocess.run(
            [sys.executable, "-c", BLOCK], capture_output=True, text=True, env=environment
        )
        assert done.returncode == 0, done.stderr[-2000:]
        found.append(done.stdout)
    assert found[0] == found[1]
