"""F-bar: its tangent, its means over cells, its stress."""

from __future__ import annotations

import itertools
import warnings

import numpy as np
import pytest
import ufl
from conftest import dense, unit_grid
from dolfinx import fem, mesh
from mpi4py import MPI
from scipy import sparse
from test_tangent import box, check, strained

import dolfinmpm as mpm
from dolfinmpm._platform import errors
from dolfinmpm.cut.cellaverages import CellAverages, sharing_stencils
from dolfinmpm.forms import PointOperator
from dolfinmpm.kinematics.fbar import FBar
from dolfinmpm.materials import Hencky, Tresca, VonMises

KINDS = ("interval", "quadrilateral", "hexahedron")
BASES = ("linear", "gimp", "bspline2", "bspline3")
SCENES = [(kind, basis) for kind in KINDS for basis in BASES]
SCENES += [("distorted quadrilateral", "linear")]


class Additive:
    """Stress of the sum of strains, sym H, without a history; not linear, and not symmetric."""

    multiplicative = False
    law = None

    def evaluate(self, operand, value, tangent, rows):
        d = round(operand.shape[1] ** 0.5)
        H = operand.reshape(-1, d, d)
        trace, eye = np.trace(H, axis1=1, axis2=2), np.eye(d)
        stress = 50 * (trace + 3 * trace**2)[:, None, None] * eye + 7 * H + 2 * H.swapaxes(1, 2)
        value[:] = stress.reshape(value.shape)
        if tangent is not None:
            by_trace = 50 * (1 + 6 * trace)[:, None, None] * np.outer(eye, eye)
            swap = np.einsum("il,jk->ijkl", eye, eye).reshape(d * d, d * d)
            tangent[:] = by_trace + 7 * np.eye(d * d) + 2 * swap
        return -1

    def commit(self, operand, rows):
        return {}


def additive(points, u, v):
    H = ufl.grad(u)
    stress = PointOperator(points, FBar(Additive(), points), H, H.ufl_shape, "additive")
    return ufl.inner(stress, ufl.grad(v)) * points.dX


def with_history(points):
    strained(points)
    points["J_bar"] = 1 + 0.1 * np.sin(np.arange(len(points)))


@pytest.mark.parametrize(("kind", "basis"), SCENES)
@pytest.mark.parametrize("strain", ["multiplicative", "volumes", "additive"])
def test_tangent_in_every_basis(kind, basis, strain):
    grid = unit_grid(kind, 2 if kind == "hexahedron" else 3)
    points = mpm.fill(grid, box(grid), 2, 1.0)
    V = mpm.Space(grid, basis)
    u, v = V.increment, V.test
    if strain == "additive":
        F = additive(points, u, v)
    else:
        fbar = strain if strain == "volumes" else True
        F = mpm.momentum(Hencky(E=10.0, nu=0.45), points, u, v, fbar=fbar)
    problem = mpm.QuasiStatic(F, u, points, mpm.fixed(V, "bottom"))
    if strain != "additive":
        with_history(points)
    check(problem)


@pytest.mark.parametrize("kind", ["quadrilateral", "hexahedron"])
@pytest.mark.parametrize("basis", ["linear", "gimp"])
@pytest.mark.parametrize(
    "law", [VonMises(10.0, 0.48, radius=0.3, hardening=1.0), Tresca(10.0, 0.48, 0.2)]
)
def test_tangent_where_points_yield(kind, basis, law):
    grid = unit_grid(kind)
    points = mpm.fill(grid, box(grid), 2, 1.0)
    V = mpm.Space(grid, basis)
    F = mpm.momentum(law, points, V.increment, V.test, fbar=True)
    problem = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))
    with_history(points)
    operator = check(problem, tolerance=5e-6).operator
    yielded = operator.points.end_state()["plastic_strain"] > 0
    assert yielded.mean() > 0.5


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("stabilisation", ["ghost", "aggregation", "extended"])
@pytest.mark.parametrize("basis", ["linear", "gimp", "bspline2"])
def test_tangent_with_stabilisations(kind, basis, stabilisation):
    grid = unit_grid(kind, 4 if kind != "hexahedron" else 3)
    points = mpm.fill(grid, box(grid, 0.6), 2, 1.0)
    V = mpm.Space(grid, basis)
    F = mpm.momentum(Hencky(E=10.0, nu=0.45), points, V.increment, V.test, fbar=True)
    problem = mpm.QuasiStatic(
        F, V.increment, points, mpm.fixed(V, "bottom"), stabilisation=stabilisation
    )
    with_history(points)
    check(problem)


def test_tangent_with_a_prolongation_of_ones_own():
    """A node follows one far away, so that a cell couples nodes at both ends."""
    grid = unit_grid("quadrilateral", 5)
    points = mpm.fill(grid, box(grid), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    x = V.function_space.tabulate_dof_coordinates()

    def prolongate(stencils, nodes):
        C = sparse.lil_matrix(sparse.identity(len(x)))
        one, other = (int(np.argmin(np.hypot(*(x[:, :2] - at).T))) for at in ((0, 0.5), (1, 0.5)))
        C[one, one], C[one, other] = 0.0, 1.0
        C = C.tocsr()
        C.eliminate_zeros()
        return C

    F = mpm.momentum(Hencky(E=10.0, nu=0.45), points, V.increment, V.test, fbar=True)
    problem = mpm.QuasiStatic(
        F, V.increment, points, mpm.fixed(V, "bottom"), prolongation=prolongate
    )
    with_history(points)
    check(problem)


@pytest.mark.parametrize("averaged", [True, False])
def test_tangent_of_wide_and_of_missing_domains(averaged):
    grid = unit_grid("quadrilateral", 6)
    points = mpm.fill(grid, mpm.Box((0.3, 0.3), (0.7, 0.7)), 2, 1.0)
    points["l"] = 0.29, 0.2
    V = mpm.Space(grid, "bspline2", averaged=averaged)
    F = mpm.momentum(Hencky(E=10.0, nu=0.45), points, V.increment, V.test, fbar=True)
    problem = mpm.QuasiStatic(F, V.increment, points)
    with_history(points)
    check(problem)


def test_tangent_of_two_laws_two_fields_and_a_nonlinear_form():
    """Two means, of which one acts through the square of its stress, beside a pressure."""
    grid = unit_grid("quadrilateral")
    points = mpm.fill(grid, box(grid, 0.5), 2, 1.0)
    half = points.add_field("half")
    points["half"] = points["x"][:, 0] < 0.5
    Q, V = mpm.Space(grid, "gimp", shape=()), mpm.Space(grid, "gimp")
    u, v, p, q = V.increment, V.test, Q.increment, Q.test
    H = ufl.grad(u)
    stress = PointOperator(points, FBar(Additive(), points), H, (2, 2), "additive")
    F = ufl.inner(half * ufl.dot(stress, stress) + p * stress, ufl.grad(v)) * points.dX
    F += ufl.tr(stress) * q * points.dx + p * q * points.dX
    F += mpm.momentum(Hencky(E=10.0, nu=0.4), points, u, v, fbar=True)
    problem = mpm.QuasiStatic(F, [u, p], points, mpm.fixed(V, "bottom"))
    (region,) = problem.form.regions
    assert region.tangent[1, 1].value
    with_history(points)
    check(problem, tolerance=1e-5)


def means_of(points, basis):
    """Means over cells, or over lower splines, as a problem takes them."""
    where = points.placement()
    shared = sharing_stencils(where, basis.stencils(where), basis)
    return CellAverages(points["V"], where, shared, basis)


@pytest.mark.parametrize("basis", BASES)
def test_patch(basis):
    """A homogeneous deformation is what it is without F-bar."""
    grid = unit_grid("quadrilateral", 4)
    results = []
    for fbar in (False, True):
        points = mpm.fill(grid, mpm.Box((0, 0), (1, 1)), 2, 1.0)
        V = mpm.Space(grid, basis)
        A = np.array([[-0.05, 0.02], [0.015, -0.04]])

        def outer(x):
            return np.any((x[:2] < 1e-9) | (x[:2] > 1 - 1e-9), axis=0)

        bcs = [
            c
            for i in (0, 1)
            for c in mpm.prescribed(V, outer, i, increment=lambda x, i=i, A=A: A[i] @ x[:2])
        ]
        F = mpm.momentum(Hencky(E=100.0, nu=0.3), points, V.increment, V.test, fbar=fbar)
        mpm.QuasiStatic(F, V.increment, points, bcs).step()
        exact = np.broadcast_to(np.eye(2) + A, points["F"].shape)
        np.testing.assert_allclose(points["F"], exact, atol=1e-10)
        results.append(points["stress"].copy())
    np.testing.assert_allclose(points["J_bar"], np.linalg.det(np.eye(2) + A), rtol=1e-10)
    np.testing.assert_allclose(results[1], results[0], atol=1e-8)


def bent(basis, law, steps=4, load=2.0, n=4, fbar=True, **options):
    """A block that leans over under its weight."""
    grid = mesh.create_rectangle(
        MPI.COMM_SELF, [(0, 0), (2, 1.5)], (2 * n, 3 * n // 2), mesh.CellType.quadrilateral
    )
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 1)), 2, 1.0)
    V = mpm.Space(grid, basis)
    u, v = V.increment, V.test
    g = fem.Constant(grid, (0.0, 0.0))
    F = mpm.momentum(law, points, u, v, fbar=fbar) - ufl.inner(g, v) * points.dX
    F += mpm.ghost(points, u, v, gamma=1.0)
    problem = mpm.QuasiStatic(F, u, points, mpm.fixed(V, "bottom"), **options)
    for k in range(1, steps + 1):
        g.value[:] = 0.5 * load * k / steps, -load * k / steps
        problem.step()
    return problem


@pytest.mark.parametrize("basis", BASES)
def test_pressure_is_that_of_the_mean_volume(basis):
    """tr σ/3 = K ln J̄ / J̄ through all steps, and σ goes with the flux S = J σ ΔF⁻ᵀ."""
    E, nu = 20.0, 0.45
    problem = bent(basis, Hencky(E=E, nu=nu))
    points = problem.points
    J_bar, J = points["J_bar"], np.linalg.det(points["F"])
    assert np.abs(J / J_bar - 1).max() > 1e-3
    pressure = np.trace(points["stress"], axis1=1, axis2=2) / 3
    np.testing.assert_allclose(pressure, E / (3 * (1 - 2 * nu)) * np.log(J_bar) / J_bar, atol=1e-10)
    # one more increment, by the operator itself
    law = FBar(problem.form.regions[0].operators[0].law.formulation, points)
    rng = np.random.default_rng(2)
    H = rng.uniform(-0.05, 0.05, (len(points), 4))
    means = means_of(points, problem.fields[0].space.basis)
    law.prepare(H, means.mean)
    S = np.empty_like(H)
    assert law.evaluate(H, S, None, np.arange(len(points), dtype=np.int32)) == -1
    new = law.commit(H, np.arange(len(points), dtype=np.int32))
    dF = H.reshape(-1, 2, 2) + np.eye(2)
    volume = J * np.linalg.det(dF)
    expected = volume[:, None, None] * (new["stress"][:, :2, :2] @ np.linalg.inv(dF).swapaxes(1, 2))
    np.testing.assert_allclose(S.reshape(-1, 2, 2), expected, atol=1e-12 * E)


@pytest.mark.parametrize("basis", BASES)
@pytest.mark.parametrize(
    "law", [Hencky(20.0, 0.49), VonMises(20.0, 0.49, radius=1.0, hardening=10.0)]
)
def test_newton_converges_quadratically(basis, law):
    options = {"petsc_options": {"snes_lag_jacobian": 1}}  # a new tangent in each iteration
    problem = bent(basis, law, load=1.0, **options)
    for record in problem.history:
        assert record.halvings == 0
        assert record.iterations <= 6
        near = [r for r in record.residuals if r < 1e-4]
        for one, other in itertools.pairwise(near):
            # far below the tolerance rounding takes over
            assert other < max(1e3 * one**2, 1e-11)
    if isinstance(law, VonMises):
        assert (problem.points["plastic_strain"] > 0).mean() > 0.05


def test_linear_functions_need_no_more_couplings():
    """They couple the nodes of a cell already; domains couple more."""
    sizes = {}
    for basis in ("linear", "gimp"):
        for fbar in (False, True):
            problem = bent(basis, Hencky(20.0, 0.3), steps=3, load=1.0, fbar=fbar)
            sizes[basis, fbar] = problem.here.pattern.indices.size
            assert ("J_bar" in problem.points.fields) == fbar
            assert problem.form.regions[0].averages == fbar
    assert sizes["linear", True] == sizes["linear", False]
    assert sizes["gimp", True] > sizes["gimp", False]


def test_the_nonlocal_part_matters(monkeypatch):
    """Without the mean's derivative the tangent would be another one."""
    problem = bent("gimp", Hencky(20.0, 0.49), steps=1, load=0.1)
    whole = dense(problem.stiffness())
    with monkeypatch.context() as patch:
        patch.setattr("dolfinmpm.assembly.region.add_outer", lambda *arguments: None)
        local = dense(problem.stiffness())
    assert np.abs(whole - local).max() > 0.1 * np.abs(whole).max()
    # of an isotropic elastic body at rest it is symmetric
    problem = bent("gimp", Hencky(20.0, 0.49), steps=0)
    rest = dense(problem.stiffness())
    np.testing.assert_allclose(rest, rest.T, atol=1e-12 * np.abs(rest).max())


def test_a_point_turned_inside_out_is_named():
    """A volume that is not positive, or not a number, fails the step and not the run."""
    problem = bent("gimp", Hencky(20.0, 0.3), steps=1, load=0.1)
    n, here = len(problem.points), problem.activate()
    law, averages = problem.form.regions[0].operators[0].law, here.regions[0].couplings[0].averages
    for bad in (-1.5, np.nan):
        H = np.zeros((n, 4))
        H[5, 0] = bad
        law.prepare(H, averages.mean)
        S = np.empty((n - 3, 4))
        first = law.evaluate(H[3:], S, None, np.arange(3, n, dtype=np.int32))
        # a mean that is not a number is one of all points of the cell
        assert first == 2 if bad < 0 else 0 <= first <= 2


def test_the_stabilisations_find_the_modulus():
    problem = bent("gimp", Hencky(20.0, 0.3), steps=1, load=0.1, stabilisation="soft")
    assert problem.stabilisation.E == 20.0


@pytest.mark.parametrize("basis", ["gimp", "bspline2", "bspline3"])
def test_cubic_splines_warn_under_a_law_that_compacts(basis):
    grid = unit_grid("quadrilateral")
    points = mpm.fill(grid, box(grid), 2, 1.0)
    V = mpm.Space(grid, basis)
    clay = mpm.materials.CamClay(
        swelling=0.02, compression=0.13, M=1.05, mu0=5e6, alpha=0.0,
        reference_pressure=2e4, preconsolidation=2e4,
    )  # fmt: skip
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for law, fbar in ((clay, True), (clay, False), (Hencky(20.0, 0.3), True)):
            F = mpm.momentum(law, points, V.increment, V.test, fbar=fbar)
            mpm.QuasiStatic(F, V.increment, points, stabilisation=mpm.Stabilisation("soft", E=1.0))
    told = [str(w.message) for w in caught if w.category is errors.SoftVolumeWarning]
    assert len(told) == (basis == "bspline3")
    assert all("CamClay" in text and 'basis="bspline2"' in text for text in told)


def test_what_f_bar_cannot_do_is_refused():
    grid = unit_grid("quadrilateral")
    points = mpm.fill(grid, box(grid), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    with pytest.raises(errors.ParameterError, match=r"fbar = True .*Hencky"):
        mpm.momentum(mpm.materials.NeoHookean(1.0, 0.3), points, u, v, fbar=True)
    stress = PointOperator(points, FBar(Additive(), points), points.F, (2, 2), "of the state")
    form = ufl.inner(stress, ufl.grad(v)) * points.dX
    with pytest.raises(errors.FormError, match="takes the gradient of one increment"):
        mpm.QuasiStatic(form, u, points)


@pytest.mark.parametrize("strain", ["large", "small"])
@pytest.mark.parametrize(
    ("law", "angle"),
    [
        (mpm.materials.DruckerPrager(10.0, 0.3, 1.0, 20.0, dilation_angle=5.0), "5"),
        (mpm.materials.MohrCoulomb(10.0, 0.3, 1.0, 30.0, dilation_angle=lambda x: 10 * x[0]), "9"),
    ],
)
def test_dilation_is_refused(law, angle, strain):
    """With the reason and the stabilisation, before the body is touched by a step."""
    grid = unit_grid("quadrilateral", 5)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 1)), 1, 1.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    with pytest.raises(errors.ParameterError, match=rf"dilation_angle = {angle} deg.*bspline2"):
        mpm.QuasiStatic(mpm.momentum(law, points, u, v, strain=strain, fbar=True), u, points)
    mpm.QuasiStatic(mpm.momentum(law, points, u, v, strain=strain), u, points)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 1)), 1, 1.0)
    plain = mpm.materials.DruckerPrager(10.0, 0.3, 1.0, 20.0, dilation_angle=0.0)
    mpm.QuasiStatic(mpm.momentum(plain, points, u, v, strain=strain, fbar=True), u, points)


@pytest.mark.parametrize("basis", BASES)
def test_points_keep_mean_volumes(basis):
    """F, V and the domains follow J̄, and a step keeps the sum of volumes that fbar=True has."""
    law = Hencky(E=20.0, nu=0.45)
    kept, true = (bent(basis, law, steps=1, fbar=fbar).points for fbar in ("volumes", True))
    J_bar = kept["J_bar"]
    assert np.ptp(J_bar) > 1e-2
    np.testing.assert_allclose(np.linalg.det(kept["F"]), J_bar, rtol=1e-12)
    np.testing.assert_allclose(kept["V"], J_bar * kept["V0"], rtol=1e-12)
    # a share of 3 % of the points' own changes
    np.testing.assert_allclose(kept["V"].sum(), true["V"].sum(), rtol=2e-3)
    assert np.abs(true["V"] / kept["V"] - 1).max() > 1e-3
    # the law does not know the difference: a pressure by J̄ after more steps, too
    points = bent(basis, law, fbar="volumes").points
    J_bar, K = points["J_bar"], 20.0 / (3 * (1 - 2 * 0.45))
    pressure = np.trace(points["stress"], axis1=1, axis2=2) / 3
    np.testing.assert_allclose(pressure, K * np.log(J_bar) / J_bar, atol=1e-10)


@pytest.mark.parametrize(
    ("strain", "options"), [("small", {}), ("large", {"configuration": "total"})]
)
def test_mean_volumes_need_a_mean(strain, options):
    """Strains without J̄, and the total configuration, refuse fbar="volumes"."""
    grid = mesh.create_unit_square(MPI.COMM_SELF, 2, 2, mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 1)), 2, 1.0)
    V = mpm.Space(grid, "linear", **options)
    with pytest.raises(mpm.errors.ParameterError, match="volumes"):
        mpm.momentum(
            Hencky(E=1.0, nu=0.3), points, V.increment, V.test, strain=strain, fbar="volumes"
        )
