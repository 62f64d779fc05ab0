"""Ghost penalties that follow the tangent of the laws, and those that find their own factor."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import COMM
from dolfinx import fem, mesh
from scenes import vibrating_bar

import dolfinmpm as mpm
from dolfinmpm._platform.errors import FormError, ParameterError
from dolfinmpm.assembly.facetpenalties import (
    INTERVALS,
    MeshPairs,
    by_ratio,
    isotropic,
    lattice_pair,
    least_penalty,
    local_constant,
    smooth_constant,
)
from dolfinmpm.assembly.facettensors import FacetTensors
from dolfinmpm.assembly.latticefacets import LatticeFacet
from dolfinmpm.assembly.stencilsums import add_product
from dolfinmpm.body.points import GHOST_FACETS
from dolfinmpm.cut.facetmoduli import FIELD, LEAST, MOST, bounded, isotropic_moduli
from dolfinmpm.materials.base import lame

BASES = {"linear": 1, "bspline2": 2, "bspline3": 3}
QUADRILATERAL = mesh.CellType.quadrilateral


def grid_of(gdim, n=7, kind=None):
    if gdim == 1:
        return mesh.create_interval(COMM, n, [0.0, n])
    if gdim == 2:
        return mesh.create_rectangle(COMM, [(0, 0), (n, n)], (n, n), kind or QUADRILATERAL)
    kind = kind or mesh.CellType.hexahedron
    return mesh.create_box(COMM, [(0, 0, 0), (n, n, n)], (n, n, n), kind)


def inner_pair(gdim, basis="linear"):
    """The pair of unit cells at a facet within a lattice, for the library's ghost penalty."""
    grid = grid_of(gdim)
    points = mpm.fill(grid, mpm.Box((0.0,) * gdim, (1.0,) * gdim), 1, 1.0)
    V = mpm.Space(grid, basis)
    form = mpm.ghost(points, V.increment, V.test, gamma=1.0)
    bilinear = ufl.derivative(form, V.increment, ufl.TrialFunction(V.function_space))
    place = LatticeFacet([np.arange(8.0)] * gdim, (3,) * gdim, 0, False)
    tensor = FacetTensors(ufl.algorithms.expand_derivatives(bilinear), BASES[basis], gdim)(place)
    return lattice_pair(place, BASES[basis], tensor)


def moduli_of(nu, E=1.0):
    lmbda, mu = lame(E, nu)
    return lmbda + 2 * mu, mu


def without_jumps(pair, full, cut):
    values, vectors = np.linalg.eigh(pair.J)
    return smooth_constant(full, cut, vectors[:, values < 1e-10 * values[-1]])


def constant(pair, nu, penalty, gdim=2):
    first, second = pair.stiffness(isotropic(*moduli_of(nu), gdim))
    return local_constant(first, second, penalty * pair.J)


# values of an independent code, for g = γ h²/(3 E)
@pytest.mark.parametrize(
    ("nu", "expected"),
    [(0.0, (414, 50, 23, 14)), (0.3, (549, 64, 29, 17)), (0.49, (7340, 746, 258, 95))],
)
def test_constants_in_units_of_youngs_modulus(nu, expected):
    pair = inner_pair(2)
    found = [constant(pair, nu, 3 * g) for g in (1 / 90, 1 / 9, 1 / 3, 1)]
    np.testing.assert_allclose(found, expected, rtol=0, atol=0.5)


def test_constants_in_units_of_the_p_wave_modulus():
    pair = inner_pair(2)
    for nu, expected in ((0.0, (414, 50, 23, 14)), (0.49, (441, 56, 28, 18))):
        M, _ = moduli_of(nu)
        found = [constant(pair, nu, 3 * g * M) for g in (1 / 90, 1 / 9, 1 / 3, 1)]
        np.testing.assert_allclose(found, expected, rtol=0, atol=0.5)
    assert constant(pair, 0.0, 1e6) == pytest.approx(9.9, abs=0.05)


def test_constant_of_a_line():
    pair = inner_pair(1)
    for g in (0.1, 1.0):
        first, second = pair.stiffness(np.ones((1, 1, 1, 1)))
        assert local_constant(first, second, 3 * g * pair.J) == pytest.approx((1 + g) / g)
        # C∞ = 1
        target = (1 + g) / g
        assert least_penalty(first, second, pair.J, target) == pytest.approx(3 * g)


@pytest.mark.parametrize(
    ("gdim", "basis"), [(2, "linear"), (3, "linear"), (2, "bspline2"), (2, "bspline3")]
)
@pytest.mark.parametrize("nu", [0.0, 0.3, 0.49, 0.495])
def test_adaptive_penalties_meet_their_target(gdim, basis, nu):
    pair = inner_pair(gdim, basis)
    M, G = moduli_of(nu)
    bound = without_jumps(pair, *pair.stiffness(isotropic(M, G, gdim)))
    for target in (30.0, 20 * bound):
        kept = np.full((1, INTERVALS + 1), np.nan)
        kind = np.zeros(1, int)
        gamma = M * by_ratio(kept, np.array([G / M]), kind, [lambda: pair], target)[0]
        assert np.isfinite(kept).sum() == 2
        expected = max(target, 2 * bound)
        assert constant(pair, nu, gamma, gdim) == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize("gdim", [1, 2, 3])
def test_isotropic_moduli(gdim):
    rng = np.random.default_rng(3)
    assert isotropic_moduli(isotropic(5.0, 2.0, gdim)[None])[0, 0] == pytest.approx(5.0)
    if gdim == 1:
        return
    np.testing.assert_allclose(isotropic_moduli(isotropic(5.0, 1.5, gdim)[None]), [[5.0, 1.5]])
    # they do not depend on axes
    D = rng.normal(size=(gdim,) * 4)
    Q, _ = np.linalg.qr(rng.normal(size=(gdim, gdim)))
    turned = np.einsum("ia,jb,kc,ld,abcd->ijkl", Q, Q, Q, Q, D)
    np.testing.assert_allclose(isotropic_moduli(turned[None]), isotropic_moduli(D[None]))


def test_moduli_have_bounds():
    elastic = np.array([[3.0, 1.0]])
    np.testing.assert_array_equal(bounded(np.array([[0.0, -1.0]]), elastic), [[3 * LEAST, LEAST]])
    np.testing.assert_array_equal(bounded(np.array([[2.0, 2.5]]), elastic), [[2.0, 2.0]])
    # F-bar leaves hardly any resistance to changes of volume
    found = bounded(np.full((2, 2), [50.0, 1.0]), np.array([[50.0, 1.0]]), np.array([False, True]))
    np.testing.assert_array_equal(found, [[50.0, 1.0], [MOST, 1.0]])


@pytest.mark.parametrize("gdim", [2, 3])
def test_cells_of_a_mesh_are_those_of_a_lattice(gdim):
    problem = block(gdim=gdim)
    (field,) = problem.here.fields
    pair, expected = MeshPairs(field.space, "scaled"), inner_pair(gdim)
    for row in field.entities[GHOST_FACETS].reshape(-1, 4)[:3]:
        found = pair(row)
        assert found.penalty(0.3, 30.0) == pytest.approx(expected.penalty(0.3, 30.0))
        np.testing.assert_allclose(
            np.linalg.eigvalsh(found.J), np.linalg.eigvalsh(expected.J), atol=1e-12
        )


def block(basis="linear", gdim=2, kind=None, law=None, n=6, load=None, **options):
    """A block with cut cells on the floor, after a step under its weight if it has one."""
    grid = grid_of(gdim, n, kind)
    low, high = (0.0,) * gdim, ((3.3, 2.6) if gdim == 2 else (2.3, 1.2, 1.6))
    points = mpm.fill(grid, mpm.Box(low, high), 2, 1.0)
    V = mpm.Space(grid, basis)
    law = law or mpm.materials.Hencky(E=1e3, nu=0.3)
    g = fem.Constant(grid, np.zeros(gdim))
    F = mpm.momentum(law, points, V.increment, V.test)
    F -= ufl.inner(g, V.test) * points.dX
    stabilisation = mpm.Stabilisation("ghost", **options)
    bcs = mpm.fixed(V, "bottom") if load else []
    problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation=stabilisation)
    for share in (0.5, 1.0) if load else ():
        g.value[-1] = -share * load
        problem.step()
    problem.activate()
    return problem


def normal_of(grid, row):
    """Unit normal of the facet (cell, local facet, cell, local facet)."""
    tdim = grid.topology.dim
    grid.topology.create_connectivity(tdim, tdim - 1)
    facet = grid.topology.connectivity(tdim, tdim - 1).links(row[0])[row[1]]
    grid.topology.create_connectivity(tdim - 1, 0)
    corners = mesh.entities_to_geometry(grid, tdim - 1, np.array([facet], np.int32))[0]
    x = grid.geometry.x[corners]
    edges = x[1:] - x[0]
    return np.linalg.svd(edges[:, :tdim])[2][-1]


GRIDS = [(2, None), (2, mesh.CellType.triangle), (3, None), (3, mesh.CellType.tetrahedron)]


def energy_of_jumps(space, rows, M, G, w):
    """The energy of a displacement's jumps in components, integrated by DOLFINx; cells of 1 m."""
    grid, gdim = space.grid, space.grid.geometry.dim
    facets = ufl.Measure("dS", grid, subdomain_data=[(1, rows.ravel().astype(np.int32))])(1)
    n = ufl.FacetNormal(grid)("+")
    first, second = ufl.grad(w), ufl.grad(ufl.grad(w))
    jump = ufl.dot(first("+") - first("-"), n)
    along = ufl.dot(second("+") - second("-"), n)
    normal = sum(jump[i] * n[i] for i in range(gdim))
    project = ufl.Identity(gdim) - ufl.outer(n, n)
    spread = sum(project[i, j] * along[i, j] for i in range(gdim) for j in range(gdim))
    density = 2 * G * sum(jump[i] ** 2 for i in range(gdim))
    density += (M - 2 * G) * (normal**2 + spread**2 / 3)
    return fem.assemble_scalar(fem.form(density / 3 * facets))


@pytest.mark.parametrize(("gdim", "kind"), GRIDS)
def test_jumps_cost_the_energy_of_shear_and_of_volume(gdim, kind):
    M, G = moduli_of(0.3, 1e3)
    problem = block(gdim=gdim, kind=kind, factor=2.0)
    (field,) = problem.here.fields
    rows = field.entities[GHOST_FACETS].reshape(-1, 4)
    w = fem.Function(field.space.function_space)
    # with mixed derivatives
    w.interpolate(
        lambda x: np.array([np.sin(x[0] + 2 * x[1] + k) * x[2 - k] ** k for k in range(gdim)])
    )
    x = field.basis.node_coordinates()[:, :gdim]
    own = field.space.function_space.tabulate_dof_coordinates()[:, :gdim]
    at = np.argmin(np.linalg.norm(own[None] - x[:, None], axis=2), axis=1)
    u = w.x.array.reshape(-1, gdim)[at]
    forces = np.zeros_like(u)
    for part in problem.here.blocks_of("stiffness"):
        add_product(part, [u], [forces])
    energy = 2 / 30 * energy_of_jumps(field.space, rows, M, G, w)
    assert float(np.sum(forces * u)) == pytest.approx(energy, rel=1e-9)


@pytest.mark.parametrize(("gdim", "kind"), GRIDS)
@pytest.mark.parametrize("factor", [None, "adaptive"])
def test_each_facet_has_its_own_factor(gdim, kind, factor):
    law = mpm.materials.Hencky(E=lambda x: 1e3 * (1 + x[0]), nu=lambda x: 0.1 + 0.1 * x[1] / 3)
    problem = block(gdim=gdim, kind=kind, law=law, factor=factor, n=4)
    modulus = problem.form.moduli[0]
    (field,) = problem.here.fields
    rows = field.entities[GHOST_FACETS].reshape(-1, 4)
    assert np.ptp(modulus.values) > 0.1 * modulus.values.mean()
    # energy of a displacement, facet by facet; its mixed second derivatives are zero
    pairs = MeshPairs(field.space, "scaled")
    x = field.basis.node_coordinates()[:, :gdim]
    u = np.sin(x) + np.cos(x[:, ::-1] * 1.3)
    energy, share = 0.0, 1.0 if factor else 1 / 30
    nodes = field.space.function_space.dofmap.list
    own = field.space.function_space.tabulate_dof_coordinates()[:, :gdim]
    at = np.argmin(np.linalg.norm(own[:, None] - x, axis=2), axis=1)
    for row, value, (M, G) in zip(rows, modulus.values, modulus.moduli):
        pair = pairs(row)
        w = u[at[np.unique(nodes[row[[0, 2]]])]].ravel()
        if not factor:
            # a jump of the first derivative resists shear, and its normal part a change of volume
            n = normal_of(field.space.grid, row)
            across = w.reshape(-1, gdim) @ n
            assert value == pytest.approx(G)
            energy += share * 2 * G * (w @ pair.J @ w)
            energy += share * (M - 2 * G) * (across @ pair.J[::gdim, ::gdim] @ across)
        else:
            energy += share * value * (w @ pair.J @ w)
            assert value / M == pytest.approx(pair.penalty(G / M, 30.0), rel=0.01)
            first, second = pair.stiffness(isotropic(M, G, gdim))
            orders = (first, second), (second, first)
            found = [local_constant(*both, value * pair.J) for both in orders]
            least = max(without_jumps(pair, *both) for both in orders)
            assert max(found) == pytest.approx(max(30.0, 2 * least), rel=0.05)
    forces = np.zeros_like(u)
    for part in problem.here.blocks_of("stiffness"):
        add_product(part, [u], [forces])
    assert float(np.sum(forces * u)) == pytest.approx(energy, rel=1e-9)


@pytest.mark.parametrize("basis", ["gimp", "bspline2"])
def test_domains_share_their_moduli_out(basis):
    problem = block(basis)
    shear, volume = problem.form.moduli
    M, G = moduli_of(0.3, 1e3)
    for modulus, value in ((shear, G), (volume, M - 2 * G)):
        np.testing.assert_allclose(modulus.moduli, np.tile([M, G], (len(modulus.values), 1)))
        np.testing.assert_allclose(modulus.values, value)


def test_the_penalty_follows_soil_that_yields():
    soil = mpm.materials.VonMises(E=1e3, nu=0.3, radius=1.5, hardening=50.0)
    points = {}
    for load in (0.5, 3.0):
        problem = block(law=soil, factor="adaptive", load=load)
        points[load] = problem.points
        (modulus,) = problem.form.moduli
        M, _ = moduli_of(0.3, 1e3)
        least = modulus.moduli[:, 0].min() / M
        assert (least < 0.9) == (load > 1), least
        yielded = points[load]["plastic_strain"] > 0
        assert yielded.any() == (load > 1)
        share = points[load][FIELD][:, 0] / M
        assert (share[~yielded] > 0.9).all()
    assert share[yielded].min() < 0.9


def test_laws_without_youngs_modulus():
    clay = mpm.materials.CamClay(
        swelling=0.01, compression=0.1, M=1.0, mu0=1e3, alpha=0.0, reference_pressure=100.0,
        reference_strain=0.0, preconsolidation=200.0,
    )  # fmt: skip
    problem = block(law=clay, factor="adaptive")
    (modulus,) = problem.form.moduli
    # K = p/κ and μ = μ0 at the reference pressure
    K = 100.0 / 0.01
    expected = [K + 4 / 3 * 1e3, 1e3]
    np.testing.assert_allclose(modulus.moduli[0], expected, rtol=1e-6)


@pytest.mark.parametrize("fbar", [False, True])
def test_moduli_of_elastic_bodies_stay(fbar):
    grid = grid_of(2, 6)
    points = mpm.fill(grid, mpm.Box((0, 0), (3.3, 2.6)), 2, 1.0)
    V = mpm.Space(grid, "linear")
    u, v = V.increment, V.test
    F = mpm.momentum(mpm.materials.Hencky(E=1e3, nu=0.4), points, u, v, strain="small", fbar=fbar)
    F -= ufl.inner(ufl.as_vector((0.0, -1e-3)), v) * points.dX
    F += mpm.ghost(points, u, v, factor=1.0)
    problem = mpm.QuasiStatic(F, u, points, mpm.fixed(V, "bottom"))
    problem.step()
    M, G = moduli_of(0.4, 1e3)
    expected = np.tile([min(M, MOST * G) if fbar else M, G], (len(points), 1))
    np.testing.assert_allclose(points[FIELD], expected, rtol=1e-4)


def test_energies_keep_their_elastic_moduli():
    problem = block(law=mpm.materials.NeoHookean(1e3, 0.3), factor="adaptive", load=1.0)
    M, G = moduli_of(0.3, 1e3)
    np.testing.assert_allclose(problem.points[FIELD][:, 1], G)
    np.testing.assert_allclose(problem.points[FIELD][:, 0], M)


def test_points_that_come_later_have_moduli():
    problem = block(load=1.0)
    points = problem.points
    more = mpm.fill(points.grid, mpm.Box((4, 0), (5.5, 1.5)), 2, 1.0)
    number = len(points)
    points.add(more)
    problem.activate()
    assert len(points) > number
    assert (points[FIELD] > 0).all()


def test_it_goes_with_dynamics():
    bar = vibrating_bar(stabilisation=mpm.Stabilisation("ghost", factor="adaptive"))
    problem = bar[0] if isinstance(bar, tuple) else bar
    problem.step(0.1)
    (modulus,) = problem.form.moduli
    assert (modulus.values > 0).all()


def test_terms_with_and_without_moduli_add_up():
    grid = grid_of(2, 6)
    points = mpm.fill(grid, mpm.Box((0, 0), (3.3, 2.6)), 2, 1.0)
    V = mpm.Space(grid, "bspline2")
    u, v = V.increment, V.test
    # ν = 0: all components of a jump have one modulus
    law = mpm.materials.Hencky(E=1e3, nu=0.0)
    M, _ = moduli_of(0.0, 1e3)

    def matrix(*terms):
        F = sum(terms, start=mpm.momentum(law, points, u, v))
        return mpm.QuasiStatic(F, u, points).stiffness()

    both = matrix(
        mpm.ghost(points, u, v, gamma=3.0),
        2 * mpm.ghost(points, u, v, factor=15.0),
        mpm.ghost(points, u, v, factor=7.5),
    )
    once = matrix(mpm.ghost(points, u, v, gamma=3.0 + 1.25 * M))
    both.axpy(-1.0, once)
    assert both.norm() < 1e-12 * once.norm()


def test_what_it_cannot_do_is_told():
    grid = grid_of(2, 4)
    points = mpm.fill(grid, mpm.Box((0, 0), (2.3, 2.6)), 2, 1.0)
    V = mpm.Space(grid, "linear")
    u, v = V.increment, V.test
    own = ufl.inner(ufl.grad(u), ufl.grad(v)) * points.dX
    with pytest.raises(FormError, match=r"no mpm\.momentum of this increment"):
        mpm.QuasiStatic(own + mpm.ghost(points, u, v, factor="adaptive"), u, points)
    with pytest.raises(ParameterError, match="factor"):
        mpm.ghost(points, u, v, factor="adaptiv")
    with pytest.raises(ParameterError, match="target = 30"):
        mpm.ghost(points, u, v, gamma=1.0, target=30.0)
    with pytest.raises(ParameterError, match="target"):
        mpm.ghost(points, u, v, factor="adaptive", target=0.5)
    scalar = mpm.Space(grid, "linear", shape=())
    with pytest.raises(ParameterError, match="displacement"):
        mpm.ghost(points, scalar.increment, scalar.test, factor="adaptive")
    with pytest.raises(ParameterError, match="factor"):
        mpm.Stabilisation("weak-aggregation", factor="adaptive")
