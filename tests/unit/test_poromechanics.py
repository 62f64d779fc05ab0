"""Soil and water in one form: tangents, undrained limits, volumes, restarts, refusals."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import Linearised, unit_grid
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm._platform.errors import (
    ConvergenceError,
    ParameterError,
)
from dolfinmpm.solve import method

LAW = mpm.materials.Hencky(E=1e4, nu=0.3)
WATER = mpm.Fluid(gravity=10.0)


def block(u="gimp", p="linear", height=0.7, n=4, law=LAW, drained=True, density=2000.0, **options):
    """A block on a sealed base between smooth walls; its form, points, spaces and top."""
    grid = unit_grid("quadrilateral", n)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, height)), 2, density, exact=True)
    V, Q = mpm.Space(grid, u), mpm.Space(grid, p, shape=())
    top = mpm.Surface(points, lambda x: x[1] > height - 1e-12, (0, 1), name="top")
    if drained is True:
        options["drained"] = top
    elif drained:
        options["drained"] = drained
    options = {"permeability": 1e-3, "porosity": 0.4, "fluid": WATER, **options}
    fields, tests = (V.increment, Q.increment), (V.test, Q.test)
    return mpm.poromechanics(law, points, fields, tests, **options), points, V, Q, top


def held(V):
    return mpm.rollers(V, "left", "right", "bottom")


def problem_of(F, points, V, Q, bcs=None, stabilisation="none", **options):
    fields = [V.increment, Q.increment]
    bcs = held(V) if bcs is None else bcs
    return mpm.Transient(F, fields, points, bcs, stabilisation=[stabilisation] * 2, **options)


OPTIONS = [
    {},
    {"strain": "small", "permeability": [[2e-3, 1e-4], [1e-4, 1e-3]]},
    {
        "fluid": mpm.Fluid(bulk_modulus=1e5),
        "gravity": (1.0, -9.81),
        "permeability": mpm.kozeny_carman(1e-3, 0.4),
    },
    {"theta": 0.5, "suction": 5.0, "u": "bspline2", "law": mpm.materials.NeoHookean(1e4, 0.3)},
    {"fbar": True, "drained": False, "strain": "jaumann"},
]


def check_tangent(problem):
    """The tangent of displacement and pressure against central differences of the residual."""
    linearised = Linearised(problem)
    rng = np.random.default_rng(1)
    start = rng.uniform(-0.02, 0.02, linearised.size)
    way = rng.uniform(-0.1, 0.1, linearised.size)
    # pressures are of another size than displacements
    ups = problem.here.unknowns.fields[0].size
    start[ups:] *= 1e3
    way[ups:] *= 1e3
    linearised.tangent(start)
    exact, t = linearised.product(way), 1e-5
    ahead, behind = linearised.residual(start + t * way), linearised.residual(start - t * way)
    numerical = (ahead - behind) / (2 * t)
    for part in (slice(0, ups), slice(ups, None)):
        np.testing.assert_allclose(
            exact[part], numerical[part], atol=2e-5 * np.abs(exact[part]).max()
        )


@pytest.mark.parametrize("options", OPTIONS, ids=range(len(OPTIONS)))
def test_tangent_is_the_derivative_of_the_residual(options):
    options = dict(options)
    pair = {"u": options.pop("u", "gimp")}
    F, points, V, Q, _ = block(**pair, **options)
    points.dt.value = 0.7
    for field in ("pressure", "pressure_gradient", "flow"):
        if field in points.fields:
            points[field] = 3.0
    problem = problem_of(F, points, V, Q, stabilisation="ghost")
    check_tangent(problem)


@pytest.mark.parametrize("u", ["linear", "gimp"])
def test_a_sealed_body_carries_an_even_load_by_its_water(u):
    """k = 0: p = q at every node, J = 1, in any measure."""
    F, points, V, Q, top = block(u, permeability=0.0, drained=False)
    F += top.traction(fem.Constant(points.grid, (0.0, -500.0)), V.test)
    problem = mpm.QuasiStatic(F, [V.increment, Q.increment], points, held(V))
    problem.step()
    np.testing.assert_allclose(points["pressure"], 500.0, rtol=1e-6)
    np.testing.assert_allclose(np.linalg.det(points["F"]), 1.0, atol=1e-9)
    assert np.abs(points["stress"]).max() < 1e-3


@pytest.mark.parametrize("stabilisation", ["none", "ghost"])
@pytest.mark.parametrize(
    ("u", "cuts", "shares"),
    [
        ("gimp", (1e-6, 0.67), (1e-8, 0.1)),
        *(
            pytest.param(u, (1e-6, 0.3, 0.67, 1.0), (1e-8, 1e-3, 0.1, 1.0), marks=pytest.mark.long)
            for u in ("linear", "gimp")
        ),
    ],
)
def test_a_first_step_does_not_overshoot(u, cuts, shares, stabilisation):
    """However short it is, and however the top cuts its cell."""
    worst = 0.0
    for cut in cuts:
        for share in shares:
            n, E, k, q = 8, 1e6, 1e-3, 1e3
            h = 1 / n
            height = (5 + cut) * h
            grid = mesh.create_rectangle(
                MPI.COMM_WORLD, [(0, 0), (h, 1)], (1, n), mesh.CellType.quadrilateral
            )
            points = mpm.fill(grid, mpm.Box((0, 0), (h, height)), 2, 1.0, exact=True)
            V, Q = mpm.Space(grid, u), mpm.Space(grid, "linear", shape=())
            top = mpm.Surface(points, lambda x, t=height: x[1] > t - 1e-12, (0, 1))
            F = mpm.poromechanics(
                mpm.materials.Hencky(E=E, nu=0.0), points, (V.increment, Q.increment),
                (V.test, Q.test), permeability=k, porosity=0.4, fluid=WATER, drained=top,
            )  # fmt: skip
            F += top.traction(fem.Constant(grid, (0.0, -q)), V.test)
            problem = problem_of(F, points, V, Q, stabilisation=stabilisation)
            problem.step(share * h**2 / (k * E / WATER.unit_weight))
            worst = max(worst, points["pressure"].max() / q - 1)
    assert worst < 0.01


def test_volumes_of_water_balance():
    """What the pores lose in a step leaves where the pressure is held; grains stay."""
    law = mpm.kozeny_carman(1, 0.4)
    F, points, V, Q, top = block(height=1.0, drained=False, permeability=law)
    F += top.traction(fem.Constant(points.grid, (0.0, -300.0)), V.test)
    problem = problem_of(F, points, V, Q, held(V) + mpm.fixed(Q, "right"))
    through, finish = [], problem.scheme.finish

    def watched(problem, operator, *given):
        # all test functions of the pressure together are 1, here M/h
        modulus, size = LAW.E * 0.7 / (1.3 * 0.4), mpm.cell_size(points.grid).value
        through.append(operator.forces()[1].sum() * size / modulus)
        return finish(problem, operator, *given)

    problem.scheme.finish = watched
    for t in (0.01, 0.05, 0.2):
        before = points["V"].sum()
        problem.step(t)
        lost = before - points["V"].sum()
        solid = (1 - points["porosity"]) * points["V"]
        np.testing.assert_allclose(solid, 0.6 * points["V0"], rtol=1e-12)
        assert lost > 1e-4
        assert through[-1] == pytest.approx(-lost, abs=1e-10)


def test_a_drained_body_ends_where_the_dry_one_does():
    F, points, V, Q, top = block("linear", height=0.75)
    load = fem.Constant(points.grid, (0.0, -200.0))
    F += top.traction(load, V.test)
    problem_of(F, points, V, Q).step(1e9)
    dry = mpm.fill(points.grid, mpm.Box((0, 0), (1, 0.75)), 2, 2000.0, exact=True)
    W = mpm.Space(points.grid, "linear")
    face = mpm.Surface(dry, lambda x: x[1] > 0.75 - 1e-12, (0, 1))
    G = mpm.momentum(LAW, dry, W.increment, W.test) + face.traction(load, W.test)
    mpm.QuasiStatic(G, W.increment, dry, held(W)).step()
    np.testing.assert_allclose(points["x"], dry["x"], atol=1e-7)
    assert np.abs(points["pressure"]).max() < 1e-3


def test_water_at_rest_stays_at_rest():
    """Hydrostatic pressure in ground that its weight has settled: nothing flows, nothing moves."""
    b = (0.0, -10.0)
    law = mpm.materials.Hencky(E=1e7, nu=0.3)
    F, points, V, Q, _ = block(height=0.75, gravity=b, density=1800.0, law=law)
    problem = problem_of(F, points, V, Q)
    problem.step(1e8)
    depth = 0.75 - points["x0"][:, 1]
    np.testing.assert_allclose(points["pressure"], 1e4 * depth, rtol=2e-3)
    before = points["x"].copy()
    mass = points["density"].copy()
    problem.step(2e8)
    np.testing.assert_allclose(points["x"], before, atol=1e-7)
    # settled ground has lost water
    assert (mass < 1800.0).all()


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_water_leaves_through_a_seepage_face_and_does_not_enter(sign):
    grid = unit_grid("quadrilateral", 4)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 1)), 2, 2000.0)
    V, Q = mpm.Space(grid, "gimp"), mpm.Space(grid, "linear", shape=())
    top = mpm.Surface(points, lambda x: x[1] > 1 - 1e-12, (0, 1))
    side = mpm.Surface(points, lambda x: x[0] > 1 - 1e-12, (1, 0))
    F = mpm.poromechanics(
        LAW, points, (V.increment, Q.increment), (V.test, Q.test), permeability=1e-2,
        porosity=0.4, fluid=WATER, seepage=side,
    )  # fmt: skip
    F += top.traction(fem.Constant(grid, (0.0, -100.0 * sign)), V.test)
    problem_of(F, points, V, Q).step(1e6)
    change = points["V"].sum() - 1
    if sign > 0:
        assert change < -1e-3
        assert np.abs(points["pressure"]).max() < 1.0
    else:
        assert abs(change) < 1e-9
        np.testing.assert_allclose(points["pressure"], -100.0, rtol=1e-6)


def test_steps_are_chosen_by_their_error():
    F, points, V, Q, top = block("linear", height=0.75)
    F += top.traction(fem.Constant(points.grid, (0.0, -20.0)), V.test)
    problem = problem_of(F, points, V, Q, error=0.02)
    problem.step(1e-3)
    for t in mpm.times(20.0, dt="auto", start=1e-3):
        problem.step(t)
    lengths = [record.dt for record in problem.history]
    assert lengths[-2] > 10 * lengths[1]
    assert problem.time == 20.0


def test_a_load_after_a_time_at_rest_keeps_to_the_bound_of_the_error():
    settled = {}
    for error in (0.02, None):
        F, points, V, Q, top = block("linear", height=0.75)
        load = fem.Constant(points.grid, (0.0, 0.0))
        problem = problem_of(F + top.traction(load, V.test), points, V, Q, error=error)
        problem.step(1e-3)
        load.value[1] = -20.0
        if error is None:
            for t in mpm.times(np.geomspace(1e-3, 1.0, 201)[1:], start=1e-3):
                problem.step(t)
        else:
            for t in mpm.times(1.0, dt="auto", start=1e-3):
                problem.step(t)
            assert problem.history[1].halvings > 0
        settled[error] = top.mean_displacement()[1]
    assert settled[0.02] == pytest.approx(settled[None], rel=0.01)


def test_a_run_goes_on_from_a_file(tmp_path):
    def made():
        F, points, V, Q, top = block(gravity=(0.0, -9.81), theta=0.5)
        F += top.traction(fem.Constant(points.grid, (0.0, -200.0)), V.test)
        return problem_of(F, points, V, Q, stabilisation="ghost", error=0.1)

    whole, stopped, later = made(), made(), made()
    for t in (0.01, 0.05, 0.2, 0.5):
        whole.step(t)
    for t in (0.01, 0.05):
        stopped.step(t)
    path = tmp_path / "soil.npz"
    stopped.save(path)
    later.load(path)
    assert later.time == 0.05
    for t in (0.2, 0.5):
        later.step(t)
    for field in ("x", "pressure", "density", "flow", "porosity", "stress"):
        np.testing.assert_array_equal(later.points[field], whole.points[field])


@pytest.mark.parametrize("permeability", [0.0, 1e-3, 1e2])
@pytest.mark.parametrize("stabilisation", ["none", "ghost"])
def test_iterations_on_blocks_find_what_factors_do(monkeypatch, stabilisation, permeability):
    found = {}
    for crossover in (10**9, 100):
        monkeypatch.setattr(method, "_CROSSOVER", {2: crossover})
        F, points, V, Q, top = block(u="gimp", height=0.82, n=12, permeability=permeability)
        half = ufl.conditional(points.x[0] < 0.5, 1.0, 0.0)
        F += top.traction(half * fem.Constant(points.grid, (0.0, -500.0)), V.test)
        problem = problem_of(F, points, V, Q, stabilisation=stabilisation, tolerance=1e-10)
        for t in (0.1, 0.2):
            record = problem.step(t)
        found[crossover] = points["x"].copy(), points["pressure"].copy()
        if crossover == 100:
            assert problem.newton.linear.method.pc == "fieldsplit"
            assert max(record.linear_iterations) < 20
    for direct, iterative in zip(*found.values()):
        np.testing.assert_allclose(iterative, direct, atol=1e-7 * np.abs(direct).max())


def test_soil_cannot_be_compressed_beyond_its_grains():
    F, points, V, Q, top = block(height=0.75, porosity=0.05, permeability=1.0)
    F += top.traction(fem.Constant(points.grid, (0.0, -9e3)), V.test)
    with pytest.raises(ConvergenceError, match=r"porosity = -?0\.\d+ of the point"):
        problem_of(F, points, V, Q, max_halvings=2).step(1e4)


def test_water_that_enters_swells_the_body_by_its_volume():
    F, points, V, Q, top = block(height=1.0, drained=False, permeability=1e-2)
    side = mpm.Surface(points, lambda x: x[0] > 1 - 1e-12, (1, 0), name="side")
    given = {"permeability": 1e-2, "porosity": 0.4, "fluid": WATER, "inflow": [(side, 2e-2)]}
    fields, tests = (V.increment, Q.increment), (V.test, Q.test)
    F = mpm.poromechanics(LAW, points, fields, tests, **given)
    problem = problem_of(F, points, V, Q)
    before = points["V"].sum()
    for t in (0.1, 0.5):
        problem.step(t)
        # the first area of the side is 1
        assert points["V"].sum() - before == pytest.approx(2e-2 * t, rel=1e-9)
    assert top.mean_displacement()[1] == pytest.approx(1e-2, rel=0.01)

    for wrong in (side, (side, "fast"), [(side, 1.0), 3]):
        with pytest.raises(ParameterError, match="inflow"):
            mpm.poromechanics(LAW, points, fields, tests, **{**given, "inflow": wrong})


@pytest.mark.parametrize("level", [0.4, 1.0, 6.0])
def test_ponded_water_leaves_effective_stresses_alone(level):
    """Under water a block carries its weight less that of the water, however deep that is."""
    stiff = mpm.materials.Hencky(E=1e8, nu=0.0)
    _, points, V, Q, top = block(law=stiff, height=1.0, drained=False, density=1.6e3)
    fields, tests = (V.increment, Q.increment), (V.test, Q.test)
    options = {"permeability": 1e-3, "porosity": 0.4, "fluid": WATER, "gravity": (0.0, -10.0)}
    F = mpm.poromechanics(stiff, points, fields, tests, ponded=[(top, level)], **options)
    problem = problem_of(F, points, V, Q)
    for t in (1e2, 1e4):
        problem.step(t)
    y = points["x0"][:, 1]
    table = max(level, 1.0)
    # where the water stands below the top, suction holds what is above it
    np.testing.assert_allclose(points["pressure"], 1e4 * (table - y), atol=30)
    middle = (np.floor(5 * y) + 0.5) / 5
    np.testing.assert_allclose(points["stress"][:, 1, 1], -(1.6e4 - 1e4) * (1 - middle), atol=30)


def test_forces_balance_however_easily_water_flows():
    """A step that is predicted ends by the measure of each field: here the flow's is far larger."""
    law, found = mpm.materials.NeoHookean(1e4, 0.3), []
    for tolerance in (1e-6, 1e-12):
        F, points, V, Q, _ = block("linear", height=1.0, drained=False, permeability=1e6, law=law)
        bcs = held(V) + mpm.prescribed(Q, "right", 0, value=-1e3)
        bcs += mpm.prescribed(V, lambda x: (x[1] > 0.99) & (x[0] < 0.3), 1, increment=-0.1)
        problem_of(F, points, V, Q, bcs, tolerance=tolerance).step(1.0)
        found.append(points["x"].copy())
    np.testing.assert_allclose(*found, atol=1e-6)
