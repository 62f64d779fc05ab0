"""UMATs: the same digits as built-in laws, tangents, faults that are told."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from mpi4py import MPI
from umats import ELASTIC, NEEDS_FORTRAN, bodies, column, umat, written

import dolfinmpm as mpm
from dolfinmpm.cut.facetmoduli import isotropic_moduli
from dolfinmpm.kinematics import strain_formulation
from dolfinmpm.kinematics.strainformulation import symmetric

pytestmark = NEEDS_FORTRAN
COMM = MPI.COMM_WORLD

PAIRS = {
    "elastic": (
        lambda: umat("elastic.f", [1e6, 0.3]),
        lambda: mpm.materials.Hencky(1e6, 0.3),
    ),
    "mises": (
        lambda: umat("mises.f", [1e6, 0.3, 2e5, 1e5], ["plastic_strain"]),
        lambda: mpm.materials.VonMises(1e6, 0.3, yield_stress=2e5, hardening=1e5),
    ),
    "mohr_coulomb": (
        lambda: umat("mohr_coulomb.f90", [1e6, 0.3, 1e5, 30.0, 10.0]),
        lambda: mpm.materials.MohrCoulomb(1e6, 0.3, 1e5, 30.0, dilation_angle=10.0),
    ),
}


@pytest.mark.parametrize("law", PAIRS)
@pytest.mark.parametrize("strain", ["jaumann", "small"])
@pytest.mark.parametrize("dim", [2, 3, "axisymmetric"])
def test_stress_and_tangent_are_those_of_the_built_in_law(dim, strain, law):
    rng = np.random.default_rng(0)
    pair, one = bodies(dim), bodies(dim)[0]
    n, e = len(one), one.strain_dim
    F = np.eye(e) + 0.1 * rng.uniform(-1, 1, (n, e, e))
    H = 0.3 * rng.uniform(-1, 1, (n, e, e))
    components = 3e4 * rng.uniform(-1, 1, (n, 6))
    if dim != 3:
        components[:, 4:] = 0.0
    if dim == "axisymmetric":
        for tensor in (F, H):
            tensor[:, :2, 2] = tensor[:, 2, :2] = 0.0
    rows, found = np.arange(n, dtype=np.int32), []
    for points, make in zip(pair, PAIRS[law]):
        points["F"][:] = F
        formulation = strain_formulation(make(), points, strain)
        formulation.bind()
        mpm.set_stress(formulation.law, points, symmetric(components), strain=strain)
        S, A = np.empty((n, e * e)), np.empty((n, e * e, e * e))
        assert formulation.evaluate(H.reshape(n, -1), S, A, rows) == -1
        new = formulation.commit(H.reshape(n, -1), rows)
        if dim == "axisymmetric":  # nothing moves out of the section
            inside = [0, 1, 3, 4, 8]
            A = A[:, inside][:, :, inside]
        found.append((S, A, new["stress"], *[new[k] for k in ("plastic_strain",) if k in new]))
    for own, exact in zip(*found):
        assert np.abs(own - exact).max() < 1e-12 * np.abs(exact).max()


@pytest.mark.parametrize("strain", ["jaumann", "small"])
@pytest.mark.parametrize("law", PAIRS)
def test_moduli_of_penalties_are_those_of_the_built_in_law_in_axisymmetry(law, strain):
    """NTENS = 4 has no shear out of the section, and an isotropic law has the same there."""
    found = []
    for points, make in zip(bodies("axisymmetric"), PAIRS[law]):
        formulation = strain_formulation(make(), points, strain)
        formulation.bind()
        n = len(points)
        S, A = np.empty((n, 9)), np.empty((n, 9, 9))
        H = np.tile(1e-6 * np.diag([1.0, -2.0, 0.5]).ravel(), (n, 1))
        assert formulation.evaluate(H, S, A, np.arange(n, dtype=np.int32)) == -1
        found.append(isotropic_moduli(A.reshape(n, 3, 3, 3, 3)))
    np.testing.assert_allclose(*found, rtol=1e-5)


@pytest.mark.parametrize("strain", ["jaumann", "small"])
def test_moduli_are_elastic_where_points_have_yielded(strain):
    """Rounding had decided between elastic and plastic moduli in penalties and wave speeds."""
    E, nu = 1e6, 0.3
    points = bodies("plane")[0]
    formulation = strain_formulation(umat("mises.f", [E, nu, 1e3, 1e5], 1), points, strain)
    formulation.bind()
    d, rows = points.gdim, np.arange(len(points), dtype=np.int32)
    H = 0.01 * np.random.default_rng(0).standard_normal((len(points), d * d))
    for name, values in formulation.commit(H, rows).items():
        points[name] = values
    assert points["state_1"].min() > 0
    M, G = E * (1 - nu) / ((1 + nu) * (1 - 2 * nu)), 0.5 * E / (1 + nu)
    found = formulation.moduli()
    np.testing.assert_allclose(found, np.broadcast_to([M, G], found.shape))
    np.testing.assert_allclose(formulation.stiffness(), M)


@pytest.mark.parametrize(
    "kind", [mpm.QuasiStatic, mpm.Newmark, pytest.param(mpm.Explicit, marks=pytest.mark.long)]
)
def test_a_column_is_that_of_the_built_in_law(kind):
    properties = [1e6, 0.3, 4e4, 2e5]
    law = umat("mises.f", properties, ["plastic_strain"])
    exact = mpm.materials.VonMises(1e6, 0.3, yield_stress=4e4, hardening=2e5)
    problems = [column(one, kind) for one in (law, exact)]
    own, other = (p.points for p in problems)
    assert own["plastic_strain"].max() > 1e-3
    orders = [np.argsort(p["id"]) for p in (own, other)]
    for name in ("x", "stress", "plastic_strain"):
        a, b = (p[name][order] for p, order in zip((own, other), orders))
        assert np.abs(a - b).max() < 1e-9 * np.abs(b).max(), name
    if kind is mpm.QuasiStatic:
        assert problems[0].history[-1].iterations == problems[1].history[-1].iterations
    else:
        assert problems[0].energies().strain > 0.0
    if kind is mpm.Explicit:
        assert not problems[0].unfused


@pytest.mark.parametrize(
    ("d", "scheme", "strain"),
    [
        (2, "usl", "jaumann"),
        pytest.param(2, "usf", "small", marks=pytest.mark.long),
        pytest.param(3, "musl", "jaumann", marks=pytest.mark.long),
    ],
)
def test_fused_steps_are_the_general_ones(d, scheme, strain, tmp_path):
    body = (
        ELASTIC
        + """
  stress = stress + 1d2*stran*dtime + 1d3*(dfgrd1(1, 2) - dfgrd0(1, 2)) + 1d-3*noel*dstran
  statev(1:3) = statev(1:3) + [time(2), dtime, coords(2)*celent]
  statev(4) = statev(4) + drot(2, 1)
  sse = sse + sum(stress*dstran)
"""
    )
    turn, found = np.array([[0, 2, 1], [-2, 0, 0], [1, 1, 0]]), []
    for fused in (True, False):
        grid = mpm.create_lattice(COMM, [np.linspace(0, 2, 5)] * d)
        points = mpm.fill(grid, mpm.Box((0.5,) * d, (1.5,) * d), 2, 1000.0)
        points["tag"] = points["x"][:, 0] > 1.0
        V = mpm.Space(grid, "gimp")
        laws = [written(tmp_path, body, state=list("abcd")),
                umat("mises.f", [1e6, 0.3, 1e4, 1e5], ["plastic_strain"])]  # fmt: skip
        F = sum(mpm.momentum(law, points, V.increment, V.test, strain=strain, tag=k)
                for k, law in enumerate(laws))  # fmt: skip
        points.add_field("velocity", (d,), "m/s")
        points["velocity"] = 3.0 * np.sin(points["x"] @ turn[:d, :d])
        problem = mpm.Explicit(F, V.increment, points, scheme=scheme, fused=fused)
        assert problem.unfused == ("" if fused else "fused=False")
        for t in (0.01, 0.03):
            problem.step(t)
            points["stress"][:, 2, 2] -= 10.0
        order = np.argsort(points["id"])
        names = ("x", "F", "stress", "total_strain", "elastic_energy", "plastic_strain", *"abcd")
        found.append({name: points[name][order] for name in names})
    assert found[0]["plastic_strain"].max() > 1e-3
    assert (np.abs(found[0]["d"]).max() > 1e-3) == (strain == "jaumann")
    for name, own in found[0].items():
        other = found[1][name]
        assert np.abs(own - other).max() <= 1e-10 * np.abs(other).max(), name


def test_the_means_of_f_bar_are_those_of_the_built_in_law():
    own, other = (column(make(), mpm.QuasiStatic, fbar=True).points for make in PAIRS["elastic"])
    assert np.abs(own["stress"] - other["stress"]).max() < 1e-9 * np.abs(other["stress"]).max()


def test_energies_of_an_elastic_and_plastic_umat():
    problem = column(umat("mises.f", [1e6, 0.3, 4e4, 2e5], ["plastic_strain"]), mpm.QuasiStatic)
    points = problem.points
    stress, nu, E = points["stress"], 0.3, 1e6
    trace = np.trace(stress, axis1=1, axis2=2)
    stored = ((1 + nu) * (stress**2).sum(axis=(1, 2)) - nu * trace**2) / (2 * E)
    np.testing.assert_allclose(points["elastic_energy"], stored, rtol=1e-12)
    own = points["plastic_strain"]
    np.testing.assert_allclose(points["plastic_dissipation"], own * (4e4 + 2e5 * own / 2), 0.1)


def test_two_umats_in_one_body_and_a_restart(tmp_path):
    grid = mpm.create_lattice(COMM, [range(5), range(6)])
    first = umat("elastic.f", [2e6, 0.2])
    second = umat("mises.f", [1e6, 0.3, 1e4, 1e5], {"plastic_strain": lambda x: 1e-3 * x[1]})

    def made():
        points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), 2, 2000.0, tag=1)
        points = points + mpm.fill(grid, mpm.Box((0, 2), (4, 4)), 2, 1800.0, tag=2)
        V = mpm.Space(grid, "gimp")
        u, v = V.increment, V.test
        F = mpm.momentum(first, points, u, v, strain="jaumann", tag=1)
        F += mpm.momentum(second, points, u, v, strain="jaumann", tag=2)
        F -= ufl.inner(ufl.as_vector((0.0, -4.0)) * points.density, v) * points.dX
        bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
        return mpm.QuasiStatic(F, u, points, bcs)

    problem = made()
    problem.step()
    upper = problem.points["tag"] == 2
    height = problem.points["x0"][upper, 1]
    assert (problem.points["plastic_strain"][upper] >= 1e-3 * height - 1e-15).all()
    assert (problem.points["plastic_strain"][~upper] == 0).all()
    problem.save(tmp_path / "state.npz")
    problem.step()
    again = made()
    again.load(tmp_path / "state.npz")
    again.step()
    for name in ("x", "stress", "plastic_strain", "total_strain", "elastic_energy"):
        assert np.array_equal(problem.points[name], again.points[name]), name


def test_a_step_is_halved_where_pnewdt_asks_for_it(tmp_path):
    body = ELASTIC + "  if (maxval(abs(dstran)) > 3d-3) pnewdt = 0.5d0"
    whole = column(written(tmp_path), mpm.QuasiStatic)
    problem = column(written(tmp_path, body), mpm.QuasiStatic)
    assert sum(r.halvings for r in whole.history) == 0
    assert sum(r.halvings for r in problem.history) > 0

    with pytest.raises(mpm.errors.ConvergenceError, match="PNEWDT < 1"):
        column(written(tmp_path, ELASTIC + "  if (noel == 7 .and. stress(2) < -1d3) pnewdt = 0"),
               mpm.QuasiStatic)  # fmt: skip


def test_an_explicit_step_that_the_umat_refuses_is_told_and_taken_back(tmp_path):
    law = written(tmp_path, ELASTIC + "  if (time(2) > 0.02) pnewdt = 0.5d0")
    V = mpm.Space(mpm.create_lattice(COMM, [range(-2, 6)] * 2), "gimp")
    points = mpm.fill(V.grid, mpm.Box((0, 0), (3, 3)), 2, 1000.0)
    F = mpm.momentum(law, points, V.increment, V.test, strain="jaumann")
    problem = mpm.Explicit(F, V.increment, points)
    points["velocity"] = np.sin(points["x"])[:, ::-1]
    problem.step(0.015)
    before = points["total_strain"].copy()
    with pytest.raises(mpm.errors.InstabilityError, match="the UMAT asks for a shorter step"):
        problem.step(0.2)
    assert not problem.unfused
    assert problem.time == 0.015
    assert np.abs(before).max() > 1e-3
    assert np.array_equal(points["total_strain"], before)
