"""Substructures: CHOLMOD's factors, and where CHOLMOD is missing."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from mpi4py import MPI
from petsc4py import PETSc

from dolfinmpm.solve import cholmod, substructures
from dolfinmpm.solve.cholmod import DONE, INDEFINITE, Factor


def grid_matrix(n, m):
    """The five-point stencil on n × m nodes."""

    def second(k):
        return sp.diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(k, k))

    return (sp.kron(second(n), sp.eye(m)) + sp.kron(sp.eye(n), second(m))).tocsr()


def factor(A, last):
    A = A.tocsr()
    A.sort_indices()
    late = np.arange(A.shape[0]) >= A.shape[0] - last
    return Factor(A.indptr, A.indices, late), A.data


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
    assert L.factorise(values) == DONE
    dense = A.toarray()
    first = slice(0, n - last)
    S = dense[n - last :, n - last :] - dense[n - last :, first] @ np.linalg.solve(
        dense[first, first], dense[first, n - last :]
    )
    order = L.order[L.late] - (n - last)
    assert np.array_equal(np.sort(order), np.arange(last))
    found = L.trailing()
    assert np.array_equal(found, np.tril(found))
    np.testing.assert_allclose(found @ found.T, S[np.ix_(order, order)], atol=1e-13)
    b = np.arange(1.0, n + 1)
    y = b[L.order]
    L.sweep(y)
    L.sweep(y, back=True)
    x = np.empty(n)
    x[L.order] = y
    np.testing.assert_allclose(A @ x, b, rtol=1e-10)


def test_factors_say_that_a_matrix_is_indefinite_and_go_on():
    A = grid_matrix(9, 9)
    L, values = factor(A, 5)
    assert L.factorise(values) == DONE
    before = L.trailing()
    assert L.factorise(-values) == INDEFINITE
    shifted = (A - 1.0 * sp.eye(81)).tocsr()
    assert L.factorise(factor(shifted, 5)[1]) == INDEFINITE
    assert L.factorise(values) == DONE
    np.testing.assert_array_equal(L.trailing(), before)


def test_no_unknowns_at_all():
    L = Factor(np.zeros(1, np.int32), np.empty(0, np.int32), np.empty(0, bool))
    assert L.factorise(np.empty(0)) == DONE
    L.sweep(np.empty(0))
    assert L.trailing().shape == (0, 0)


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


@pytest.mark.parametrize("fault", ["header", "function", "library"])
def test_a_library_that_is_not_there_is_done_without(monkeypatch, tmp_path, fault):
    def missing():
        raise OSError("cholmod.h of SuiteSparse is not installed")

    if fault == "header":
        monkeypatch.setattr(cholmod, "_header", missing)
    else:
        # a function of CHOLMOD that the header does not declare, or that the library does not have
        declared = "int absent(void);\n" if fault == "library" else ""
        source = declared + cholmod._SOURCE.replace("cholmod_start(&c)", "absent()")
        monkeypatch.setattr(cholmod, "_SOURCE", source)
    monkeypatch.setattr(cholmod.jit, "get_options", lambda: {"cache_dir": tmp_path})
    for cached in (cholmod._compiled, cholmod.unavailable):
        cached.cache_clear()
    try:
        said = {"header": "not installed", "function": "not compile", "library": "not load"}
        assert said[fault] in cholmod.unavailable()
        assert not list(tmp_path.glob("*/"))
    finally:
        monkeypatch.undo()
        for cached in (cholmod._compiled, cholmod.unavailable):
            cached.cache_clear()
    assert cholmod.unavailable() == ""
