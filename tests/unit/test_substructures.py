"""Substructures: CHOLMOD's factors, the unknowns between ranks, and what stands for absent ones."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from mpi4py import MPI
from petsc4py import PETSc

from dolfinmpm.solve import cholmod, substructures
from dolfinmpm.solve.cholmod import Factor
from dolfinmpm.solve.separators import Interior, Separator, cover


def grid_matrix(n, m):
    """The five-point stencil on n × m nodes."""

    def second(k):
        return sp.diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(k, k))

    return (sp.kron(second(n), sp.eye(m)) + sp.kron(sp.eye(n), second(m))).tocsr()


def factor(A, last):
    lower = sp.tril(A).tocsc()
    return Factor(lower.indptr.astype(np.int32), lower.indices.astype(np.int32), last), lower.data


@pytest.mark.parametrize("last", [0, 1, 7, 60])
@pytest.mark.parametrize("apart", [False, True])
def test_the_last_block_is_the_factor_of_the_schur_complement(last, apart):
    A = grid_matrix(20, 12)
    if apart:
        # two bodies, so that the last unknowns are those of two trees
        A = sp.block_diag([A, 3.0 * A]).tocsr()
        order = np.random.default_rng(0).permutation(A.shape[0])
        A = A[order][:, order]
    n = A.shape[0]
    L, values = factor(A, last)
    assert L.factorise(values)
    dense = A.toarray()
    first = slice(0, n - last)
    S = dense[n - last :, n - last :] - dense[n - last :, first] @ np.linalg.solve(
        dense[first, first], dense[first, n - last :]
    )
    order = np.argsort(L.place[n - last :])
    found = L.trailing()
    assert np.array_equal(found, np.tril(found))
    np.testing.assert_allclose(found @ found.T, S[np.ix_(order, order)], atol=1e-13)
    b, x = np.arange(1.0, n + 1), np.empty(n)
    x[L.place] = b
    L.forward(x)
    L.backward(x)
    np.testing.assert_allclose(A @ x[L.place], b, rtol=1e-10)


def test_factors_say_that_a_matrix_is_indefinite_and_go_on():
    A = grid_matrix(9, 9)
    L, values = factor(A, 5)
    assert L.factorise(values)
    before = L.trailing()
    assert not L.factorise(-values)
    shifted = (A - 1.0 * sp.eye(81)).tocsr()
    assert not L.factorise(factor(shifted, 5)[1])
    assert L.factorise(values)
    np.testing.assert_array_equal(L.trailing(), before)


def test_no_unknowns_at_all():
    L = Factor(np.zeros(1, np.int32), np.empty(0, np.int32), 0)
    assert L.factorise(np.empty(0))
    L.forward(np.empty(0))
    assert L.trailing().shape == (0, 0)


@pytest.mark.parametrize("seed", range(20))
def test_a_cover_is_the_smallest(seed):
    """Against all covers, of small graphs."""
    random = np.random.default_rng(seed)
    left, right = random.integers(0, 5, 8), 10 + random.integers(0, 5, 8)
    pairs = np.unique(np.stack([left, right]), axis=1)
    found = cover(*pairs.astype(np.int32))
    assert all(a in found or b in found for a, b in pairs.T)
    nodes = np.unique(pairs)

    def covers(chosen):
        kept = nodes[[bool(chosen >> k & 1) for k in range(nodes.size)]]
        return np.all(np.isin(pairs[0], kept) | np.isin(pairs[1], kept)) and kept.size

    sizes = [size for size in map(covers, range(2**nodes.size)) if size]
    assert found.size == np.unique(found).size == min(sizes)


def test_a_pattern_that_is_not_symmetric_is_refused():
    """Row 0 of rank 0 is coupled to row 1 of rank 1, which is not coupled to it."""
    separator = Separator(np.empty(0, np.int32), slice(0, 0), 0, 1)
    with pytest.raises(RuntimeError, match="symmetric"):
        Interior.of(separator, np.array([0, 2], np.int32), np.array([0, 1], np.int32))


def test_a_preconditioner_of_one_rank():
    A = grid_matrix(8, 8).tocsr()
    matrix = PETSc.Mat().createAIJ(A.shape, csr=(A.indptr, A.indices, A.data), comm=MPI.COMM_SELF)
    pc = PETSc.PC().create(MPI.COMM_SELF)
    pc.setOperators(matrix)
    pc.setType("python")
    pc.setPythonContext(substructures.Substructures())
    b, x = matrix.createVecs()
    b.getArray()[:] = np.arange(64.0)
    pc.setUp()
    pc.apply(b, x)
    np.testing.assert_allclose(A @ x.getArray(), b.getArray(), rtol=1e-11, atol=1e-12)
    matrix.scale(-1.0)
    pc.setUp()
    assert pc.getFailedReason() == PETSc.PC.FailedReason.FACTOR_NUMERIC_ZEROPIVOT


@pytest.mark.parametrize("fault", ["absent", "old", "without"])
def test_a_library_that_is_not_there_is_done_without(monkeypatch, fault):
    class Old:
        def cholmod_version(self, version):
            version[0] = 4

        def __getattr__(self, name):
            return lambda *args: None

    def load(name):
        if fault == "absent":
            raise OSError(f"{name}: cannot open shared object file")
        return Old() if fault == "old" else object()

    monkeypatch.setattr(cholmod.ctypes, "CDLL", load)
    for cached in (cholmod._library, cholmod.unavailable):
        cached.cache_clear()
    try:
        said = {"absent": "cannot open", "old": "version 4, and not 5", "without": "no function"}
        assert said[fault] in cholmod.unavailable()
    finally:
        monkeypatch.undo()
        for cached in (cholmod._library, cholmod.unavailable):
            cached.cache_clear()
    assert cholmod.unavailable() == ""


@pytest.mark.parametrize("n", [0, 1, 5])
def test_the_product_of_a_factor_leaves_the_factor(n):
    L = np.tril(1.0 + np.arange(n * n).reshape(n, n))
    before = L.copy()
    np.testing.assert_allclose(substructures._product(L), before @ before.T, rtol=1e-14)
    np.testing.assert_array_equal(L, before)
