"""Boundaries that do not fit the grid in explicit steps: forces, stable steps, energy, rest."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import COMM
from dolfinx import fem, mesh

import dolfinmpm as mpm
from dolfinmpm._platform.errors import FormError, InstabilityError
from dolfinmpm.dynamics import explicitcall
from dolfinmpm.dynamics.boundaryforces import weighed
from dolfinmpm.dynamics.critical import critical_step

SIDES = mesh.CellType.quadrilateral
LAW = mpm.materials.Hencky(E=1000.0, nu=0.3)


def block(low=(0.53, 0.54), kind="penalty", n=4, basis="gimp", law=LAW, space=None, **options):
    """A block under gravity in a box without a lid, no side of which is a line of the grid."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (2, 2)], (2 * n, 2 * n), SIDES)
    (a, b), (c, d) = low, np.add(low, (1.0, 0.75))
    points = mpm.fill(grid, mpm.Box((a, b), (c, d)), 2, 1.0, aligned="body")
    V = mpm.Space(grid, basis, **(space or {}))
    u, v = V.increment, V.test
    F = mpm.momentum(law, points, u, v)
    F -= ufl.inner(points.density * ufl.as_vector((0.0, -10.0)), v) * points.dX
    if kind == "wall":
        box = [(a, 1.9), (a, b), (c, b), (c, 1.9)]
        line = mpm.Boundary.from_polygon(points, box, closed=False, follows=False)
        F += mpm.signorini(line, u, v, law=law, **{"penalty": 10.0, **options})
    else:
        box = [(a, d), (a, b), (c, b), (c, d)]
        line = mpm.Boundary.from_polygon(points, box, closed=False)
        options = {"direction": "normal", "method": kind, **options}
        if kind == "penalty":
            options.setdefault("penalty", 10.0)
        F += mpm.dirichlet(line, u, v, law=law, **options)
    return points, V, F, line


def total_energy(problem):
    """Of motion and of stress, and what work has been done for it."""
    e = problem.energies()
    return e.kinetic + e.strain, e.kinetic + e.strain + e.dissipated - e.external


@pytest.mark.parametrize("kind", ["penalty", "wall", "nitsche"])
@pytest.mark.parametrize("basis", ["gimp", "bspline2"])
@pytest.mark.parametrize("share", [0.0, 1e-6, 1e-3, 0.12, 0.6, 1 - 1e-6])
def test_the_step_is_below_that_of_the_eigenproblem(kind, basis, share):
    """Wherever the box lies; with a penalty it is no slave of small cuts either."""
    stabilisation = "aggregation" if kind == "nitsche" else "none"
    points, V, F, _ = block(np.array((0.5, 0.5)) + 0.25 * share, kind, basis=basis)
    problem = mpm.Explicit(F, V.increment, points, stabilisation=stabilisation)
    step = problem.critical_step()
    assert step <= problem.critical_step(exact=True)
    free = critical_step(points, V.basis, problem.form.parts.declarations, "lumped")
    assert 0.05 * free < step < free


def test_what_row_sums_bound():
    """The largest eigenvalue of a penalty by the lumped mass, from a matrix of the traces."""
    points, V, F, line = block((0.51, 0.53))
    problem = mpm.Explicit(F, V.increment, points)
    assert "do not fit the grid" in problem.unfused
    here = problem.activate()
    k = line.markers["dirichlet1_stiffness"].copy()
    here, found = weighed(problem.form, here)
    s, kept = (
        here.boundaries[line.markers.number].regions[0].stencils[0],
        line.markers["dirichlet1_stiffness"] / k,
    )
    np.testing.assert_array_equal(kept, 1.0)
    assert found.share == 0.0
    count = V.basis.nodes.size
    K, m = np.zeros((count, count)), np.zeros(count)
    for p in range(len(line.markers)):
        nodes, N, _ = s.row(p)
        assert N.min() >= 0
        assert N.sum() == pytest.approx(1.0)
        stiff = line.markers["dirichlet1_stiffness"][p] * line.markers["V"][p]
        K[np.ix_(nodes, nodes)] += stiff * np.outer(N, N)
    for p in range(len(points)):
        nodes, N, _ = here.fields[0].stencils.row(p)
        m[nodes] += points["density"][p] * points["V0"][p] * N
    on = m > 0
    half = K[np.ix_(on, on)] / np.sqrt(np.outer(m[on], m[on]))
    largest = np.linalg.eigvalsh(half)[-1]
    assert largest <= found.rate * (1 + 1e-12)
    assert found.rate < 4 * largest


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        ("penalty", {}),
        ("penalty", {"scheme": "usl"}),
        ("penalty", {"scheme": "usf"}),
        ("penalty", {"mapping": "apic"}),
        ("wall", {}),
        ("nitsche", {"stabilisation": "aggregation"}),
    ],
    ids=lambda o: o if isinstance(o, str) else "-".join(o.values()),
)
def test_energy_of_what_bounces_in_a_box(kind, options):
    """Gravity comes at once: four swings, and no more energy than the first one has."""
    points, V, F, line = block(kind=kind)
    problem = mpm.Explicit(F, V.increment, points, **options)
    assert problem.unfused
    found, force = [], []
    for t in mpm.times(0.4, dt="auto"):
        problem.step(t)
        found.append(total_energy(problem))
        force.append(line.force()[1])
    stored, balance = np.array(found).T
    weight = 10.0 * points["V0"].sum()
    # twice the weight at the end of the first swing, none at that of the second
    assert np.max(force) == pytest.approx(2 * weight, rel=0.25)
    assert np.mean(force) == pytest.approx(weight, rel=0.1)
    first = stored[: len(stored) // 4].max()
    assert stored.max() < 1.05 * first
    # "usf" gains by itself, beside sides of the grid too
    assert balance.max() < (0.25 if options.get("scheme") == "usf" else 0.03) * first


@pytest.mark.parametrize("kind", ["penalty", "nitsche"])
def test_damped_it_comes_to_the_quasi_static_state(kind):
    points, V, F, line = block(kind=kind)
    explicit = mpm.Explicit(F, V.increment, points, damping=0.3, stabilisation="aggregation")
    for t in mpm.times(0.6, dt="auto"):
        explicit.step(t)
    others, V, F, other = block(kind=kind)
    mpm.QuasiStatic(F, V.increment, others, stabilisation="aggregation").step()
    moved, exact = points["x"] - points["x0"], others["x"] - others["x0"]
    assert np.abs(moved - exact).max() < 0.02 * np.abs(exact).max()
    np.testing.assert_allclose(line.force(), other.force(), atol=0.01 * 7.5)


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_a_slab_falls_onto_an_incline_and_slides(friction):
    """As the point mass does, once the jolt is over; nothing adds energy but gravity."""
    angle, g, fall, until = np.radians(30.0), 10.0, 2e-3, 0.2
    down = np.array([np.cos(angle), -np.sin(angle)])
    into = np.array([-np.sin(angle), -np.cos(angle)])
    grid = mesh.create_rectangle(COMM, [(0, 0), (2.0, 1.8)], (20, 18), SIDES)
    start, a = np.array([0.4, 1.3]), np.arange(0.025, 0.5, 0.05)
    x = np.array([start + p * down - (q + fall) * into for p in a for q in a[:3]])
    points = mpm.MaterialPoints.from_arrays(grid, x, 0.05**2, 1000.0, half_length=0.025)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    law = mpm.materials.Hencky(E=2e5, nu=0.2)
    ends = [start - 0.3 * down, start + 1.5 * down]
    slope = mpm.Boundary.from_polygon(points, ends, closed=False, follows=False)
    F = mpm.momentum(law, points, u, v)
    F += mpm.signorini(slope, u, v, law=law, friction=friction, penalty=10.0)
    F -= ufl.inner(points.density * ufl.as_vector((0.0, -g)), v) * points.dX
    problem = mpm.Explicit(F, u, points)
    points["velocity"] = np.zeros(2)
    mass, rows = 1000.0 * 0.05**2 * len(x), []
    for t in mpm.times(until, dt="auto"):
        problem.step(t)
        v = np.mean(points["velocity"], axis=0)
        rows.append((problem.time, v @ down, v @ into, *slope.force(), total_energy(problem)[1]))
    times, along, across, *force, balance = np.array(rows).T
    late = times > until / 2
    rate = np.polyfit(times[late], along[late], 1)[0]
    assert rate == pytest.approx(g * (np.sin(angle) - friction * np.cos(angle)), rel=0.03)
    # impulses of the wall are the change of momentum
    impulse = np.cumsum(np.array(force) * np.diff(times, prepend=0.0), axis=1)[:, -1]
    for n, v, pull in ((down, along, np.sin(angle)), (into, across, np.cos(angle))):
        assert impulse @ n == pytest.approx(mass * (v[-1] - g * until * pull), abs=0.02 * mass)
    # at first it sticks
    rubbed, pressed = np.abs(impulse @ down), -impulse @ into
    assert rubbed == pytest.approx(friction * pressed, rel=0.06, abs=1e-9)
    assert rubbed <= friction * pressed + 1e-9
    work = 0.5 * mass * (along[-1] ** 2 + across[-1] ** 2)
    assert balance.max() < 0.03 * work
    assert np.abs((points["x"] - points["x0"]) @ into - fall).max() < 0.01


def test_what_is_prescribed_moves_by_the_clock():
    """A block is carried by its unfitted foot, which the constant of the time drives."""
    points, V, *_ = block()
    clock = fem.Constant(points.grid, 0.0)
    foot = mpm.Boundary.from_polygon(points, [(0.53, 0.54), (1.53, 0.54)], closed=False)
    way = ufl.as_vector((0.0, 0.2 * clock))
    F = mpm.momentum(LAW, points, V.increment, V.test)
    F += mpm.dirichlet(foot, V.increment, V.test, way, law=LAW, method="penalty", penalty=10.0)
    points.add_field("velocity", (2,), "m/s")
    points["velocity"] = [0.0, 0.2]
    problem = mpm.Explicit(F, V.increment, points, time=clock)
    problem.step(0.3)
    np.testing.assert_allclose(points["x"] - points["x0"], [[0.0, 0.06]] * len(points), atol=1e-4)
    np.testing.assert_allclose(foot.markers["x"][:, 1], 0.6, atol=1e-4)
    assert np.abs(foot.markers["dirichlet1_gap"]).max() < 1e-4


@pytest.mark.parametrize("what", ["total", "rings"])
def test_other_configurations(what):
    """At first positions, and axisymmetric, a damped block stands on its unfitted foot."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (2, 2)], (8, 8), SIDES)
    rings = what == "rings"
    (a, b), (c, d) = (0.0 if rings else 0.5, 0.54), (1.0, 1.29)
    points = mpm.fill(grid, mpm.Box((a, b), (c, d)), 2, 1.0, aligned="body", axisymmetric=rings)
    V = mpm.Space(grid, "gimp", configuration="updated" if rings else "total")
    u, v = V.increment, V.test
    law = mpm.materials.Hencky(E=1000.0, nu=0.0)
    foot = mpm.Boundary.from_polygon(points, [(a, b), (c, b)], closed=False)
    F = mpm.momentum(law, points, u, v)
    F += mpm.dirichlet(foot, u, v, law=law, method="penalty", direction=(0, 1), penalty=10.0)
    F -= ufl.inner(points.density * ufl.as_vector((0.0, -10.0)), v) * points.dX
    problem = mpm.Explicit(F, u, points, mpm.rollers(V, "left") if rings else [], damping=0.6,
                           stabilisation="aggregation")  # fmt: skip
    for t in mpm.times(0.4, dt="auto"):
        problem.step(t)
    weight = 10.0 * points["V0"].sum()
    assert foot.force()[1] == pytest.approx(weight, rel=0.01)
    top = points["x0"][:, 1].max()
    sunk = (points["x"] - points["x0"])[points["x0"][:, 1] > top - 0.01, 1]
    # of the column, and of what the penalty gives way
    exact = 10 / 1000 * (0.75 * (top - b) - 0.5 * (top - b) ** 2) + 10 * 0.75 / (10 * 1000 / 0.25)
    np.testing.assert_allclose(sunk, -exact, rtol=0.05)


def test_an_unstable_run_goes_back_with_its_markers(monkeypatch):
    points, V, F, line = block()
    problem = mpm.Explicit(F, V.increment, points)
    problem.step(0.01)
    before = {name: values.copy() for name, values in line.markers.fields.items()}
    monkeypatch.setattr(explicitcall, "checked_courant", float)
    problem.courant = 4.0
    with pytest.raises(InstabilityError):
        problem.step(0.2)
    assert problem.time == pytest.approx(0.01)
    for name in ("x", "area", "dirichlet1_gap", "dirichlet1_reached"):
        np.testing.assert_array_equal(line.markers[name], before[name], err_msg=name)


def test_a_run_goes_on_from_a_checkpoint(tmp_path):
    def build():
        points, V, F, line = block(kind="wall", friction=0.3)
        return mpm.Explicit(F, V.increment, points), points, line

    first, points, line = build()
    for k in range(4):
        first.step(0.01 * (k + 1))
        if k == 1:
            first.save(tmp_path / "half.npz")
    again, others, other = build()
    again.load(tmp_path / "half.npz")
    for k in (2, 3):
        again.step(0.01 * (k + 1))
    for name in ("x", "velocity", "stress"):
        np.testing.assert_array_equal(others[name], points[name], err_msg=name)
    np.testing.assert_array_equal(other.force(), line.force())


@pytest.mark.parametrize(
    ("kind", "options", "text"),
    [
        ("skew", {}, 'method="skew"'),
        ("penalty", {"mass": "consistent"}, 'take mass="lumped"'),
        ("penalty", {"collision": mpm.Collision(tags=(1, 2))}, "terms or collision"),
    ],
    ids=["skew", "consistent", "collision"],
)
def test_what_cannot_be_is_refused(kind, options, text):
    points, V, F, _ = block(kind=kind)
    with pytest.raises(FormError, match=text):
        mpm.Explicit(F, V.increment, points, **options)
