"""Distributed matrices, and factors by substructures: whoever owns which unknowns."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
import ufl
from dolfinx import fem, mesh
from petsc4py import PETSc

import dolfinmpm as mpm
from dolfinmpm.assembly.ownedrows import OwnedRows
from dolfinmpm.solve import method
from dolfinmpm.solve import substructures as module
from dolfinmpm.solve.substructures import Substructures

from .common import COMM, run

REASON = PETSc.PC.FailedReason


def _stencil(n):
    """The nine-point stencil B on n × n nodes, and scales s of its rows that differ widely."""
    one = sp.diags([1.0, 1.0, 1.0], [-1, 0, 1], shape=(n, n))
    A = -sp.kron(one, one)
    A = A - sp.diags(np.asarray(A.sum(axis=1)).ravel() - 0.01)
    return A, 10.0 ** np.random.default_rng(1).uniform(-3, 3, n * n)


def _distributed(A, ends):
    """Rows of a matrix by the ranks' ends."""
    low, high = ends[COMM.rank], ends[COMM.rank + 1]
    rows = A[low:high].tocsr()
    rows.sort_indices()
    sizes = ((high - low, A.shape[0]),) * 2
    return PETSc.Mat().createAIJ(sizes, csr=(rows.indptr, rows.indices, rows.data), comm=COMM)


def _shares(n):
    """Numbers of the first rows: even, none on a rank, next to all between ranks, one row each."""
    p = COMM.size
    yield n * np.arange(p + 1) // p
    yield np.array([0] * p + [n])
    yield np.array([0] + [n] * p)
    yield np.minimum(np.arange(p + 1) * 3, n) * (np.arange(p + 1) < p) + n * (np.arange(p + 1) == p)


def factors_in_parts():
    """Solutions do not depend on who owns what; what is indefinite is so on all ranks."""
    B, s = _stencil(14)
    A, n = (sp.diags(s) @ B @ sp.diags(s)).tocsr(), s.size
    b = np.random.default_rng(2).uniform(-1, 1, n)
    # without the scales, which cost the reference digits on some processors
    exact = np.linalg.solve(B.toarray(), b / s) / s
    pc, found = PETSc.PC().create(COMM), []
    pc.setType("python")
    pc.setPythonContext(Substructures())
    for ends in _shares(n):
        mine = slice(ends[COMM.rank], ends[COMM.rank + 1])
        matrix = _distributed(A, ends)
        right, x = matrix.createVecs()
        right.getArray()[:] = b[mine]
        pc.setOperators(matrix)
        pc.setUp()
        assert pc.getFailedReason() == REASON.NOERROR
        pc.apply(right, x)
        off = np.abs(x.getArray() - exact[mine]) / np.abs(exact[mine])
        assert off.max(initial=0.0) < 1e-11
        found.append(COMM.allreduce(float(x.getArray().sum())))
        # indefinite inside of the last rank that has rows, and between ranks
        last = int(np.flatnonzero(np.diff(ends))[-1])
        between = ends[1] if COMM.size > 1 and 0 < ends[1] < n else n - 1
        for row in (ends[last + 1] - 1, between):
            kept = A[row, row]
            bad = A.tolil()
            bad[row, row] = -kept
            bad = _distributed(bad.tocsr(), ends)
            pc.setOperators(bad)
            pc.setUp()
            assert pc.getFailedReason() == REASON.FACTOR_NUMERIC_ZEROPIVOT
        pc.setOperators(matrix)
        pc.setUp()
        pc.apply(right, x)
        off = np.abs(x.getArray() - exact[mine]) / np.abs(exact[mine])
        assert off.max(initial=0.0) < 1e-9
        pc.reset()
    if COMM.size > 1:
        # the first unknown of the first rank is coupled to the last unknown, which is not coupled
        one = sp.eye(n, format="lil")
        one[0, n - 1] = 1.0
        one[n - 1, 1] = 1.0
        pc.setOperators(_distributed(one.tocsr(), n * np.arange(COMM.size + 1) // COMM.size))
        with pytest.raises(PETSc.Error):
            pc.setUp()
    return {"sums": found}


def _block(cells, load, law=None, push=0.0, **options):
    """A block that slides off the lower left of the grid as its weight is applied."""
    grid = mesh.create_rectangle(
        COMM, [(0, 0), (1.5, 1.5)], (cells, cells), mesh.CellType.quadrilateral
    )
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 1)), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    g = fem.Constant(grid, (0.0, 0.0))
    law = law or mpm.materials.Hencky(E=10.0, nu=0.3)
    F = mpm.momentum(law, points, u, v) - ufl.inner(points.density * g, v) * points.dX
    F -= push * ufl.inner(u, v) * points.dC
    bcs = mpm.fixed(V, "bottom")
    loads = [(0.3 * load * k, -load * k) for k in range(1, 6)]
    return run(points, V, F, bcs, loads, g, **options)


def steps_in_parts():
    """Steps with several activations; kept factors, and what cannot be in substructures."""
    figures = {}
    kept, method._KEPT = method._KEPT, {**method._KEPT, 2: 1000}
    # on any number of ranks, however small the problem
    most, module._MOST_BETWEEN = module._MOST_BETWEEN, np.inf
    mumps = {"mat_mumps_icntl_14": 30}
    plastic = mpm.materials.VonMises(E=10.0, nu=0.3, radius=0.2)
    for name, cells, load, law in (("few", 12, 0.2, None), ("many", 48, 0.04, plastic)):
        problem, figures[name] = _block(cells, load, law)
        other, _ = _block(cells, load, law, petsc_options=mumps)
        assert len(set(figures[name]["unknowns"])) > 1
        # rounding may give a rank other points
        gathered = [one.points.gather("x", "stress") for one in (problem, other)]
        for ours, theirs in zip(*gathered) if COMM.rank == 0 else ():
            np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-9 * np.abs(theirs).max())
        several = COMM.size > 1
        assert ("substructures" in problem.info()) == several
        package = other.newton.linear.method.package
        assert package == ("mumps" if several else "cholmod")
        assert ("the options set MUMPS" in other.info()) == several
        figures[name].pop("moved")
    package = problem.newton.linear.method.package
    assert package == ("substructures" if several else "cholmod")
    # conjugate gradients took old factors
    solved, made = problem.newton.linear.reuse.counts
    assert made < solved
    method._KEPT = kept

    # springs that push: a tangent that is not definite
    problem, figures["pushed"] = _block(16, 1e-3, push=40.0)
    assert problem.newton.linear.method.package == "mumps"
    assert all(record.halvings == 0 for record in problem.history)
    figures["pushed"].pop("moved")

    # what a rank has is little beside what is between them
    module._MOST_BETWEEN = 0.0
    problem, figures["between"] = _block(8, 0.2)
    module._MOST_BETWEEN = most
    assert ("too many unknowns between" in problem.info()) == (COMM.size > 1)
    figures["between"].pop("moved")
    return figures


def rows_of_all_ranks():
    """A matrix that all ranks add to, whichever rows they have and own."""
    n, found = 60, []
    for share, ends in enumerate(_shares(n)):
        owned = int(ends[COMM.rank + 1] - ends[COMM.rank])
        # whoever runs this, what rank r has depends on r alone; one of them has nothing
        of_ranks = [np.random.default_rng(10 * share + r) for r in range(COMM.size)]
        parts = []
        for r, random in enumerate(of_ranks):
            count = 0 if share == 2 and r == 1 else 25
            number = random.permutation(n)[:count].astype(np.int32)
            own = sp.random(count, count, 0.3, format="csr", random_state=random)
            parts.append((number, own))
        number, own = parts[COMM.rank]
        rows = OwnedRows(COMM, own.indptr, own.indices, number, owned, n)
        for factor in (1.0, -2.5):
            rows.put(factor * own.data)
            whole = sp.csr_matrix((n, n))
            for other, entries in parts:
                entries = entries.tocoo()
                at = other[entries.row], other[entries.col]
                whole = whole + sp.csr_matrix((factor * entries.data, at), (n, n))
            mine = slice(ends[COMM.rank], ends[COMM.rank + 1])
            start, columns, values = rows.petsc.getValuesCSR()
            got = sp.csr_matrix((values, columns, start), (owned, n)).toarray()
            np.testing.assert_allclose(got, whole[mine].toarray(), rtol=1e-14, atol=1e-15)
            # no entries but those that some rank has
            assert np.array_equal(np.sort(columns), np.sort(whole[mine].indices))
            x, y = rows.petsc.createVecs()
            x.getArray()[:] = np.arange(n)[mine]
            rows.petsc.mult(x, y)
            np.testing.assert_allclose(y.getArray(), whole[mine] @ np.arange(n), atol=1e-11)
        found.append(n)
    return {"sizes": found}
