"""Soil and water with inertia, against waves and the telegraph equation."""

from __future__ import annotations

import math

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm._platform.errors import FormError, ParameterError

LENGTH, CELLS, M, DENSITY, POROSITY = 10.0, 20, 1e6, 2000.0, 0.4


def column(**options):
    """A column of soil that stands on a sealed base; points, spaces, top, form and conditions."""
    h = LENGTH / CELLS
    grid = mesh.create_rectangle(
        MPI.COMM_WORLD, [(0, 0), (h, LENGTH + 4 * h)], (1, CELLS + 4), mesh.CellType.quadrilateral
    )
    points = mpm.fill(grid, mpm.Box((0, 0), (h, LENGTH)), 2, DENSITY)
    V, Q = mpm.Space(grid, "gimp"), mpm.Space(grid, "gimp", shape=())
    top = mpm.Surface(points, lambda x: x[1] > LENGTH - 1e-9, (0, 1), name="top")
    if options.pop("open_top", False):
        options["drained"] = top
    fields, tests = (V.increment, Q.increment), (V.test, Q.test)
    soil = mpm.materials.Hencky(E=M, nu=0.0)
    F = mpm.poromechanics(soil, points, fields, tests, porosity=POROSITY, **options)
    return F, points, list(fields), V, top, mpm.rollers(V, "left", "right", "bottom")


def test_an_undrained_bar_has_the_period_of_both_phases():
    """P-waves run with (M + K_w/n)/ρ, for soil and water move as one."""
    water = mpm.Fluid(bulk_modulus=4e5)
    F, points, fields, _, _, bcs = column(permeability=0.0, fluid=water)
    c = math.sqrt((M + 4e5 / POROSITY) / DENSITY)
    problem = mpm.Newmark(F, fields, points, bcs, stabilisation=["ghost", "ghost"])
    points["velocity"][:, 1] = 1e-3 * c * np.sin(0.5 * math.pi * points["x"][:, 1] / LENGTH)
    t, p = [], []
    for end in mpm.times(3.2 * LENGTH / c, dt=0.4 * LENGTH / CELLS / c):
        problem.step(end)
        t.append(problem.time)
        p.append(problem.momentum()[1])
    k = np.flatnonzero(np.diff(np.sign(p)))
    assert k.size == 2
    first = t[k[0]] - p[k[0]] * (t[k[0] + 1] - t[k[0]]) / (p[k[0] + 1] - p[k[0]])
    assert first == pytest.approx(LENGTH / c, rel=2e-3)
    # water that does not leave carries its share by volume
    ratio = points["pressure"] / points["stress"][:, 1, 1]
    assert np.median(ratio) == pytest.approx(-4e5 / POROSITY / M, rel=2e-3)


@pytest.mark.parametrize(
    ("coarsen", "projection", "storage"), [(1, "auto", 2.26), (2, "none", 1.0)]
)
def test_stiff_water_and_the_projection_of_the_pressure(coarsen, projection, storage):
    """With N cells per wavelength the projection stores π² K_w/(N² n M) times what K_w does."""
    stiffness, cells = 204.0 * M, 10  # K_w/n, as of water in soft soil; N = 40
    h, waves = LENGTH / cells, 0.5 * math.pi / LENGTH
    assert 1 + (math.pi / 40) ** 2 * 204.0 == pytest.approx(2.26, abs=0.01)
    lines = [np.arange(3) * h, np.arange(cells + 1) * h]
    grid = mpm.create_lattice(MPI.COMM_WORLD, lines)
    points = mpm.fill(grid, mpm.Box((0, 0), (2 * h, LENGTH)), 2, DENSITY)
    V, Q = mpm.Space(grid, "gimp"), mpm.Space(grid, "gimp", shape=(), coarsen=coarsen)
    fields, water = (V.increment, Q.increment), mpm.Fluid(bulk_modulus=POROSITY * stiffness)
    options = {"permeability": 0.0, "fluid": water, "projection": projection}
    soil, tests = mpm.materials.Hencky(E=M, nu=0.0), (V.test, Q.test)
    F = mpm.poromechanics(soil, points, fields, tests, porosity=POROSITY, **options)
    bcs = mpm.rollers(V, "left", "right", "bottom") + mpm.fixed(Q, "top")
    problem = mpm.Newmark(F, fields, points, bcs)
    points["velocity"][:, 1] = 1e-6 * np.sin(waves * points["x"][:, 1])
    t, p = [0.0], [problem.momentum()[1]]
    quarter = LENGTH / math.sqrt((M + stiffness / storage) / DENSITY)
    while p[-1] > 0.0:
        problem.step(problem.time + quarter / 50)
        t.append(problem.time)
        p.append(problem.momentum()[1])
    first = t[-2] + p[-2] * (t[-1] - t[-2]) / (p[-2] - p[-1])
    assert first == pytest.approx(quarter, rel=0.02)


def settlement(times, damping, density=DENSITY):
    """−M u(L)/(qL) of ρ ü + ρ d u̇ = M u'' under a load q put on at once, by its series."""
    k = (2 * np.arange(400) + 1) * math.pi / 2 / LENGTH
    w = k * math.sqrt(M / density)
    s = np.sqrt((0.5 * damping) ** 2 - w**2 + 0j)
    found = []
    for t in times:
        both = np.exp((s - 0.5 * damping) * t), np.exp((-s - 0.5 * damping) * t)
        left = 0.5 * (both[0] + both[1]) + 0.25 * damping / s * (both[0] - both[1])
        found.append(np.sum(2 / (k * LENGTH) ** 2 * (1 - left.real)))
    return np.array(found)


def sinking(problem, top, first, load):
    """Times (s), and settlements of the top under a load (Pa) by those in the end."""
    times, found = [], []
    for t in mpm.times(4.0 / first, dt=0.05 / first):
        problem.step(t)
        times.append(problem.time)
        found.append(-top.mean_displacement()[1] * M / (load * LENGTH))
    return times, np.array(found)


@pytest.mark.parametrize("share", [0.5, 5.0])
def test_a_sudden_load_obeys_the_telegraph_equation(share):
    """Incompressible water drags by γ_w/k, a damping of the soil's waves: over a sealed base the
    water's volume through any section is that of the soil that has sunk below it."""
    water = mpm.Fluid(density=1000.0, gravity=9.81)
    first = 0.5 * math.pi / LENGTH * math.sqrt(M / DENSITY)
    damping, load = share * first, 1e3
    k = water.unit_weight / (DENSITY * damping)
    F, points, fields, V, top, bcs = column(permeability=k, fluid=water, open_top=True)
    F += top.traction(fem.Constant(points.grid, (0.0, -load)), V.test)
    problem = mpm.Newmark(F, fields, points, bcs, stabilisation=["ghost", "ghost"])
    times, found = sinking(problem, top, first, load)
    error = np.abs(found - settlement(times, damping))
    assert error.max() < 0.03
    # the front and its echoes go through some cells, all else is smooth
    assert np.sqrt(np.mean(error**2)) < 0.01


@pytest.mark.parametrize(
    ("rule", "options"), [(mpm.GeneralisedAlpha, {"rho_inf": 0.8}), (mpm.Newmark, {})]
)
def test_rates_are_those_of_the_level_where_forces_balance(rule, options):
    """A bar of Kelvin and Voigt: amplitudes fall by exp(−ηω²t/2M)."""
    h = LENGTH / CELLS
    grid = mesh.create_rectangle(
        MPI.COMM_WORLD, [(0, 0), (h, LENGTH + 4 * h)], (1, CELLS + 4), mesh.CellType.quadrilateral
    )
    points = mpm.fill(grid, mpm.Box((0, 0), (h, LENGTH)), 2, DENSITY)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    omega = 0.5 * math.pi / LENGTH * math.sqrt(M / DENSITY)
    viscosity = 0.1 * M / omega
    F = mpm.momentum(mpm.materials.Hencky(E=M, nu=0.0), points, u, v)
    F += viscosity / points.dt * ufl.inner(ufl.grad(u), ufl.grad(v)) * points.dX
    bcs = mpm.rollers(V, "left", "right", "bottom")
    problem = rule(F, u, points, bcs, stabilisation="ghost", **options)
    points["velocity"][:, 1] = 1e-4 * np.sin(0.5 * math.pi * points["x"][:, 1] / LENGTH)
    start = problem.momentum()[1]
    end = 2 * math.pi / (omega * math.sqrt(1 - 0.05**2))
    for t in mpm.times(end, dt=end / 200):
        problem.step(t)
    assert problem.momentum()[1] / start == pytest.approx(math.exp(-0.05 * omega * end), rel=5e-3)

    with pytest.raises(FormError, match=r"rates over points\.dt, and increments are 0"):
        mpm.Explicit(F, u, points, bcs)


def test_levels_of_another_rule_are_refused():
    F, points, fields, _, _, bcs = column(permeability=1e-5)
    with pytest.raises(FormError, match=r"carries 'p.* at 1 of a step, .* at 0\.555556: .* 0\.8"):
        mpm.GeneralisedAlpha(F, fields, points, bcs)
    mpm.GeneralisedAlpha(F, fields, points, bcs, rho_inf=0.0)
    F, points, fields, _, _, bcs = column(permeability=1e-5, rho_inf=0.8)
    for problem in (mpm.Newmark, mpm.Transient, mpm.QuasiStatic):
        with pytest.raises(
            FormError, match=rf"but {problem.__name__} balances forces at 1: .* none"
        ):
            problem(F, fields, points, bcs)
    with pytest.raises(FormError, match=r"at 0\.666667: .* rho_inf, 0\.5 here"):
        mpm.GeneralisedAlpha(F, fields, points, bcs, rho_inf=0.5)
    mpm.GeneralisedAlpha(F, fields, points, bcs, rho_inf=0.8)
    with pytest.raises(ParameterError, match=r"theta = 0\.5 weights the flow"):
        column(permeability=1e-5, rho_inf=0.8, theta=0.5)
    with pytest.raises(ParameterError, match="rho_inf = 2"):
        column(permeability=1e-5, rho_inf=2)
