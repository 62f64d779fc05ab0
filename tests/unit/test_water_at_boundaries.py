"""Conditions on boundaries that do not fit the grid, of a body of soil and water."""

import numpy as np
import pytest
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm

M, H, h, LOAD = 1e6, 1.0, 0.125, 300e3
CLAY = mpm.materials.Hencky(M, 0.0)


def column(held, low=0.0, strain="large", configuration="updated", axisymmetric=False, **given):
    """A column of clay between smooth sides, under a load of 0.3 M for 0.1 of H²/c_v."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [h * np.arange(3), h * np.arange(-1, 11)])
    box = mpm.Box((0, low), (2 * h, low + H))
    points = mpm.fill(grid, box, 2, 1800.0, exact=True, axisymmetric=axisymmetric)
    V = mpm.Space(grid, "gimp", configuration=configuration)
    Q = mpm.Space(grid, "gimp", shape=(), configuration=configuration)
    u, p = V.increment, Q.increment
    top = mpm.Surface(points, lambda x: np.isclose(x[1], low + H), normal=(0, 1))
    flow = {"permeability": 1e-8, "porosity": 0.5, "drained": top, "strain": strain}
    F = mpm.poromechanics(CLAY, points, (u, p), (V.test, Q.test), **flow)
    F += top.traction(fem.Constant(grid, (0.0, -LOAD)), V.test)
    bcs, base = mpm.rollers(V, "left", "right"), None
    if held == "boundary":
        base = mpm.Boundary.from_polygon(points, [(0, low), (2 * h, low)], closed=False)
        usual = {"law": CLAY, "direction": "normal", "strain": strain, "pore_pressure": p}
        F += mpm.dirichlet(base, u, V.test, 0.0, **(usual | given))
    else:
        bcs += mpm.prescribed(V, lambda x: np.isclose(x[1], 0.0), 1)
    problem = mpm.Transient(F, [u, p], points, bcs, stabilisation=["ghost", "ghost"])
    for t in (100.0, 0.1 * H**2 * 9810 / (1e-8 * M)):
        problem.step(t)
    return points, -top.mean_displacement()[1], base


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"strain": "small"},
        {"axisymmetric": True},
        {"configuration": "total"},
        {"method": "skew"},
    ],
    ids=lambda options: next(iter(options), "usual"),
)
def test_a_base_within_cells_carries_the_water(options):
    """Without the pressure in the traction, the base was off by a tenth of a cell's extension."""
    same = {k: v for k, v in options.items() if k != "method"}
    _, fitted, _ = column("nodes", **same)
    area = np.pi * (2 * h) ** 2 if options.get("axisymmetric") else 2 * h
    for low in (0.0, 0.3 * h):
        _, settled, base = column("boundary", low, **options)
        assert low > 0.0 or settled == pytest.approx(fitted, rel=1e-3)
        gaps = (base.markers["x"] - base.markers["x0"])[:, 1]
        assert abs(np.average(gaps, weights=base.markers["V"])) < 1e-3 * settled
        assert base.force()[1] == pytest.approx(LOAD * area, rel=1e-6)


def test_a_condition_without_the_pressure_is_refused():
    with pytest.raises(mpm.errors.FormError, match="pore_pressure=p"):
        column("boundary", pore_pressure=None)
    # a stiff penalty needs no traction
    column("boundary", pore_pressure=None, method="penalty")


@pytest.mark.parametrize("given", [{"method": "penalty"}, {"pore_pressure": 1e3}])
def test_a_pressure_that_cannot_act_is_refused(given):
    with pytest.raises(mpm.errors.ParameterError, match="pore_pressure"):
        column("boundary", **given)


@pytest.mark.parametrize("basis", ["gimp", "bspline2"])
def test_an_undrained_block_within_cells_has_one_pressure(basis):
    """Skempton's pressure in plane strain: p/S = 1/(1 + (λ + G) n/K_w), the same at all points."""
    E, nu, n, bulk, load = 1e7, 0.25, 0.4, 1e7, 10.0
    lines = 0.25 * (np.arange(-1, 7) + 0.3)
    grid = mpm.create_lattice(MPI.COMM_WORLD, [lines, lines])
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 1)), 2, 2e3, exact=True)
    V = mpm.Space(points.grid, basis)
    Q = mpm.Space(points.grid, "gimp" if basis == "gimp" else "linear", shape=())
    u, v, p, soil = V.increment, V.test, Q.increment, mpm.materials.Hencky(E, nu)
    water = {"porosity": n, "permeability": 1e-9, "fluid": mpm.Fluid(bulk_modulus=bulk)}
    F = mpm.poromechanics(soil, points, (u, p), (v, Q.test), **water)
    loaded = mpm.Boundary.from_polygon(points, [(1, 0), (1, 1), (0, 1)], closed=False)
    F += loaded.pressure(load, u, v)
    held = mpm.Boundary.from_polygon(points, [(0, 1), (0, 0), (1, 0)], closed=False)
    F += mpm.dirichlet(held, u, v, 0.0, law=soil, direction="normal", pore_pressure=p)
    mpm.Transient(F, [u, p], points, [], stabilisation=["ghost", "ghost"]).step(1.0)
    stiffness = 0.5 * E / (1 + nu) / (1 - 2 * nu)
    expected = load / (1 + stiffness * n / bulk)
    np.testing.assert_allclose(points["pressure"], expected, rtol=1e-6)
