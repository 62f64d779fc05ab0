"""The 1D block sweep: condition numbers and critical steps (Coombs 2023, doi 10.1002/nme.7332)."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import mesh
from mpi4py import MPI
from petsc4py import PETSc
from scipy import linalg

import dolfinmpm as mpm
from dolfinmpm import study
from dolfinmpm._platform.errors import FormError, ParameterError

OFFSETS = (1e-6, 1e-4, 1e-3, 0.01, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 0.9, 0.999, 1 - 1e-6)


def worst(kind, basis="gimp", h=1.0, factor_m=1.0, offsets=OFFSETS, **options):
    def scene(offset):
        grid = mesh.create_interval(MPI.COMM_WORLD, 8, [0.0, 8 * h])
        body = mpm.Box((2 + offset) * h, (6 + offset) * h)
        points = mpm.fill(grid, body, 2, 1.0, aligned="body")
        V = mpm.Space(grid, basis)
        F = mpm.momentum(mpm.materials.Hencky(E=1.0, nu=0.0), points, V.increment, V.test)
        stabilisation = mpm.Stabilisation(kind, E=1.0, nu=0.0, **options)
        problem = mpm.QuasiStatic(F, V.increment, points, stabilisation=stabilisation)
        return study.conditioning(problem, 1.0, factor_m)

    figures = study.worst(study.sweep(scene, offsets))
    figures["dt_consistent"] /= h
    figures["dt_lumped"] /= h
    return figures


def test_without_a_stabilisation():
    figures = worst("none")
    assert figures["kappa_M"] == pytest.approx(3e25, rel=0.2)
    assert figures["kappa_K"] == pytest.approx(3e12, rel=0.05)
    assert figures["dt_consistent"] == pytest.approx(2e-7, rel=0.3)
    assert figures["dt_lumped"] == pytest.approx(0.803, rel=0.01)


def test_ghost_penalty():
    figures = worst("ghost")
    assert figures["kappa_M"] == pytest.approx(37.2, rel=0.01)
    assert figures["kappa_K"] == pytest.approx(287, rel=0.01)
    assert figures["dt_consistent"] == pytest.approx(0.575, rel=0.01)
    assert figures["dt_lumped"] == pytest.approx(1.3e-5, rel=0.05)


def test_ghost_penalty_of_the_stiffness_alone():
    figures = worst("ghost", factor_m=0.0)
    assert figures["kappa_K"] == pytest.approx(287, rel=0.01)
    assert figures["dt_consistent"] == pytest.approx(3e-12, rel=0.1)


@pytest.mark.parametrize("h", [10.0, 0.1, 0.01])
def test_scaled_ghost_penalty_does_not_depend_on_the_unit_of_length(h):
    assert worst("ghost", h=h)["kappa_K"] == pytest.approx(287, rel=0.01)


@pytest.mark.parametrize(("h", "kappa"), [(10.0, 54), (0.1, 2.7e4), (0.01, 2.7e6)])
def test_literal_ghost_penalty_does(h, kappa):
    assert worst("ghost", h=h, scaling="literal")["kappa_K"] == pytest.approx(kappa, rel=0.02)


@pytest.mark.parametrize("kind", ["aggregation", "extended"])
def test_aggregation_with_full_cells_as_roots(kind):
    figures = worst(kind, threshold=0.995)
    assert figures["kappa_M"] <= 12.7
    assert figures["kappa_K"] <= 9.5
    assert figures["dt_consistent"] >= 0.5 - 1e-9
    assert figures["dt_lumped"] >= 0.765


@pytest.mark.parametrize("basis", ["linear", "gimp", "bspline2", "bspline3"])
@pytest.mark.parametrize("kind", ["ghost", "aggregation", "weak-aggregation", "extended", "soft"])
def test_every_stabilisation_bounds_every_basis(basis, kind):
    """However small the cut: ten thousand times smaller makes no difference."""
    options = {"threshold": 0.5} if "agg" in kind or kind == "extended" else {}
    small, smaller = (
        worst(kind, basis, offsets=(a, 0.5), **options)["kappa_K"] for a in (1e-5, 1e-9)
    )
    assert small < 1e5
    assert smaller == pytest.approx(small, rel=0.02)


CUTS = (1e-6, 1e-4, 1e-3, 0.01, 0.05, 0.1, 0.2, 0.35, 0.5, 0.699, 0.701, 0.999)
# On splines the threshold is that of what the last function sees of the body; at the usual
# 0.5 one is left alone with 1/48 of its integral, and κ is up to 160 times the best.
FOR_SPLINES = {"ghost": {}, "aggregation": {"threshold": 0.7}, "extended": {"threshold": 0.7}}


@pytest.mark.parametrize("kind", FOR_SPLINES)
def test_column_of_quadratic_splines_wherever_its_top_cuts(kind):
    """The column that compacts under its weight, 16 cells high, fixed at the bottom."""
    n, h = 16, 50.0 / 16
    found = []
    for cut in CUTS:
        grid = mesh.create_rectangle(
            MPI.COMM_WORLD, [(0, 0), (h, (n + 1) * h)], (1, n + 1), mesh.CellType.quadrilateral
        )
        body = mpm.Box((0, 0), (h, (n - 1 + cut) * h))
        points = mpm.fill(grid, body, 2, 80.0, aligned="body")
        V = mpm.Space(grid, "bspline2")
        F = mpm.momentum(mpm.materials.Hencky(E=10e3, nu=0.0), points, V.increment, V.test)
        bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
        stabilisation = mpm.Stabilisation(kind, E=10e3, nu=0.0, **FOR_SPLINES[kind])
        problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation=stabilisation)
        found.append(study.condition_number(problem.stiffness()))
    assert max(found) <= 20 * min(found)


@pytest.mark.parametrize("kind", FOR_SPLINES)
def test_turned_block_of_quadratic_splines(kind):
    """Eight cut places of a free square of eight by eight cells, each with its own angle."""
    found = []
    for k in range(8):
        grid = mesh.create_rectangle(
            MPI.COMM_WORLD, [(0, 0), (14, 14)], (14, 14), mesh.CellType.quadrilateral
        )
        offset = (k + 1) * (np.sqrt(5) - 1) / 2 % 1
        angle = k * (np.sqrt(2) - 1) % 1 * 90
        corner = np.array([3 + offset, 3 + 0.7 * offset])
        body = mpm.TurnedBox(corner, corner + 8, angle)
        points = mpm.fill(grid, body, 3, 1.0, aligned="body")
        V = mpm.Space(grid, "bspline2")
        F = mpm.momentum(mpm.materials.Hencky(E=1.0, nu=0.0), points, V.increment, V.test)
        stabilisation = mpm.Stabilisation(kind, E=1.0, nu=0.0, **FOR_SPLINES[kind])
        problem = mpm.QuasiStatic(F, V.increment, points, stabilisation=stabilisation)
        K, modes = problem.stiffness(), study.rigid_modes(problem.here)
        found.append(study.condition_number(K, kernel=modes))
    assert max(found) <= 20 * min(found)


@pytest.mark.parametrize("kind", ["weak-aggregation", "soft"])
def test_stabilisations_by_name_take_the_modulus_of_the_law(kind):
    grid = mesh.create_interval(MPI.COMM_WORLD, 8, [0.0, 8.0])
    points = mpm.fill(grid, mpm.Box(0, 4.2), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    F = mpm.momentum(mpm.materials.Hencky(E=7.0, nu=0.2), points, V.increment, V.test)
    problem = mpm.QuasiStatic(F, V.increment, points, stabilisation=kind)
    assert (problem.stabilisation.E, problem.stabilisation.nu) == (7.0, 0.2)
    energy = mpm.momentum(mpm.materials.NeoHookean(E=8.0, nu=0.1), points, V.increment, V.test)
    problem = mpm.QuasiStatic(energy, V.increment, points, stabilisation=kind)
    assert (problem.stabilisation.E, problem.stabilisation.nu) == (8.0, 0.1)
    own = 7.0 * ufl.inner(ufl.grad(V.increment), ufl.grad(V.test)) * points.dX
    with pytest.raises(ParameterError, match="needs a modulus"):
        mpm.QuasiStatic(own, V.increment, points, stabilisation=kind)
    with pytest.raises(ParameterError, match="'glue' must be one of"):
        mpm.QuasiStatic(F, V.increment, points, stabilisation="glue")


def stiffness_of(law, stabilisation):
    """Stiffness of a bar by name of the stabilisation."""
    grid = mesh.create_interval(MPI.COMM_WORLD, 8, [0.0, 8.0])
    points = mpm.fill(grid, mpm.Box(0, 4.2), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    F = mpm.momentum(law, points, V.increment, V.test)
    problem = mpm.QuasiStatic(F, V.increment, points, stabilisation=stabilisation)
    return problem.stiffness()[:, :]


@pytest.mark.parametrize("law", [mpm.materials.Hencky, mpm.materials.NeoHookean])
def test_a_ghost_penalty_by_name_takes_the_modulus_of_the_tangent(law):
    E, nu = 7.0, 0.2
    # M of a bar that cannot get wider
    M = E * (1 - nu) / ((1 + nu) * (1 - 2 * nu))
    own = law(E=E, nu=nu)
    bare, named = stiffness_of(own, "none"), stiffness_of(own, "ghost")
    assert np.abs(named - bare).max() > 0.01 * M
    np.testing.assert_allclose(
        named, stiffness_of(own, mpm.Stabilisation("ghost", E=M)), rtol=1e-12, atol=1e-12 * M
    )


def test_a_ghost_penalty_by_name_needs_a_law():
    grid = mesh.create_interval(MPI.COMM_WORLD, 8, [0.0, 8.0])
    points = mpm.fill(grid, mpm.Box(0, 4.2), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    own = 7.0 * ufl.inner(ufl.grad(V.increment), ufl.grad(V.test)) * points.dX
    with pytest.raises(FormError, match=r"no mpm.momentum .* give it a γ"):
        mpm.QuasiStatic(own, V.increment, points, stabilisation="ghost")


def matrix_of(A):
    return PETSc.Mat().createAIJ(A.shape, csr=_csr(A), comm=PETSc.COMM_SELF)


def _csr(A):
    from scipy import sparse

    B = sparse.csr_matrix(A)
    return B.indptr, B.indices, B.data


def test_condition_numbers_of_known_matrices():
    assert study.condition_number(matrix_of(np.diag([1e-30, 1.0, 10.0]))) == pytest.approx(1e31)
    assert study.condition_number(matrix_of(np.diag([-1.0, 1.0]))) == np.inf
    # graded entries keep their digits, off the diagonal too
    d = np.array([1.0, 1e-8, 1e-15])
    A = (np.eye(3) + 0.3 * (np.ones((3, 3)) - np.eye(3))) * np.outer(d, d)
    exact = 1 / (d[2] ** 2 * (1 - 0.09 * 2 / 1.3))
    assert study.condition_number(matrix_of(A)) == pytest.approx(exact, rel=1e-6)


@pytest.mark.parametrize("limit", [2000, 3])
def test_scaled_matrices_forget_the_size_of_their_unknowns(monkeypatch, limit):
    monkeypatch.setattr("dolfinmpm.solve.spectra.DENSE_LIMIT", limit)
    n = 12
    K = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    exact = study.condition_number(matrix_of(K))
    d = 10.0 ** np.linspace(-2, 2, n)
    matrix = matrix_of(K * np.outer(d, d))
    assert study.condition_number(matrix) > 1e4 * exact
    for _ in range(2):
        # the matrix itself stays
        kappa = study.condition_number(matrix, scaled=True)
        assert kappa == pytest.approx(exact, rel=1e-6)
    # a free chain: the kernel is scaled, too
    K[0, 0] = K[-1, -1] = 1
    root = np.sqrt(np.diag(K))
    values = np.linalg.eigvalsh(K / np.outer(root, root))
    chain = matrix_of(K * np.outer(d, d))
    kappa = study.condition_number(chain, kernel=(1 / d)[:, None], scaled=True)
    assert kappa == pytest.approx(values[-1] / values[1], rel=1e-6)
    with pytest.raises(ParameterError, match="has -1 on its diagonal"):
        study.condition_number(matrix_of(np.diag([-1.0, 1.0])), scaled=True)


@pytest.mark.parametrize("limit", [2000, 10])
def test_lanczos_finds_what_all_eigenvalues_say(monkeypatch, limit):
    """A free chain of springs, its translation left out."""
    monkeypatch.setattr("dolfinmpm.solve.spectra.DENSE_LIMIT", limit)
    n = 60
    K = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    K[0, 0] = K[-1, -1] = 1
    M = np.diag(np.linspace(1, 2, n)) + 0.1 * (np.eye(n, k=1) + np.eye(n, k=-1))
    values = np.linalg.eigvalsh(K)
    kernel = np.ones((n, 1))
    kappa = study.condition_number(matrix_of(K), kernel=kernel)
    assert kappa == pytest.approx(values[-1] / values[1], rel=1e-5)
    for lumped in (False, True):
        mass = np.diag(M.sum(axis=1)) if lumped else M
        largest = linalg.eigh(K, mass, eigvals_only=True)[-1]
        step = study.critical_step(matrix_of(K), matrix_of(M), lumped=lumped)
        assert step == pytest.approx(2 / np.sqrt(largest), rel=1e-6)


def test_observed_orders():
    h = np.array([1.0, 0.5, 0.25])
    np.testing.assert_allclose(study.observed_orders(h, 3 * h**2), [2, 2])
