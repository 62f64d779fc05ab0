"""Hardin and Drnevich's stiffness: backbone, damping and loops in closed form, memory, tangents."""

from __future__ import annotations

import math

import numpy as np
import pytest
from mpi4py import MPI
from scipy.stats import special_ortho_group

import dolfinmpm as mpm
from dolfinmpm._platform.errors import ParameterError, StateError
from dolfinmpm.materials import HardinDrnevich
from dolfinmpm.materials.umatcall import DDSDDE, STATEV, STRESS
from dolfinmpm.materials.umatshim import OFFSETS
from dolfinmpm.study import element_test

G, REFERENCE, A = 60e6, 1e-4, 0.385
DE, DROT = OFFSETS["dstran"], OFFSETS["drot"]
ROWS, COLUMNS = [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]


def soil(**more):
    return HardinDrnevich(G=G, nu=0.2, reference_strain=REFERENCE, **more)


def backbone(gamma):
    return G * gamma / (1 + A * np.abs(gamma) / REFERENCE)


def sheared(law, to, steps=50, strain="small", **more):
    test = element_test(law, "simple shear", to, strain=strain, steps=steps, **more)
    return np.array(test["strain_xy"]), np.array(test["stress_xy"]), test


@pytest.mark.parametrize("strain", ["small", "jaumann"])
@pytest.mark.parametrize("amplitude", [1e-5, 1e-4, 1e-3, 1e-2])
def test_stiffness_damping_and_loops_of_cycles(amplitude, strain):
    law, n = soil(), 200
    gamma, tau, _ = sheared(law, [amplitude, -amplitude] * 2 + [amplitude], n, strain)
    first = slice(1, n + 1)
    exact = 1 / (1 + A * gamma[first] / REFERENCE)
    assert tau[first] / (G * gamma[first]) == pytest.approx(exact, rel=1e-4)
    # the first loop, and the second, which runs over the first
    for start in (n, 3 * n):
        loop = slice(start, start + 2 * n + 1)
        assert tau[loop][-1] == pytest.approx(tau[loop][0], rel=1e-5)
        x = A * amplitude / REFERENCE
        # Masing's rule on the hyperbola, ΔW/(4π W)
        masing = 4 / math.pi * (1 + 1 / x) * (1 - math.log1p(x) / x) - 2 / math.pi
        area = np.trapezoid(tau[loop], gamma[loop])
        found = abs(area) / (2 * math.pi * tau[n] * amplitude)
        assert found == pytest.approx(masing, rel=1e-3)


@pytest.mark.parametrize("steps", [1, 7])
def test_loops_inside_of_loops_are_remembered(steps):
    """Each loop that closes leaves the way to the branch outside, whatever the steps."""
    a = 5e-4
    gamma, tau, test = sheared(soil(), np.array([1, -0.4, 0.6, 0.1, 0.7, -0.5, 1.4]) * a, steps)
    at = steps * np.arange(8)
    turn, level = tau[at], np.array(test["reversals"])[at]
    assert gamma[at[7]] == pytest.approx(1.4 * a)

    def branch(start, stress, end):
        return stress + 2 * backbone((end - start) / 2)

    assert turn[1] == pytest.approx(backbone(a))
    assert turn[2] == pytest.approx(branch(a, turn[1], -0.4 * a))
    assert turn[3] == pytest.approx(branch(-0.4 * a, turn[2], 0.6 * a))
    assert turn[4] == pytest.approx(branch(0.6 * a, turn[3], 0.1 * a))
    # from 0.1 past 0.6, on the branch from −0.4
    assert turn[5] == pytest.approx(branch(-0.4 * a, turn[2], 0.7 * a))
    # from 0.7 past −0.4, on the branch from 1
    assert turn[6] == pytest.approx(branch(a, turn[1], -0.5 * a))
    # from −0.5 past 1, on the first loading
    assert turn[7] == pytest.approx(backbone(1.4 * a))
    assert level.tolist() == [0, 0, 1, 2, 3, 2, 1, 0]


@pytest.mark.parametrize("steps", [1, 5])
def test_without_room_inner_loops_go_back_along_their_branch(steps):
    a = 5e-4
    law = soil(reversals=2)
    assert len(law.internal) == 7 + 12
    _, tau, test = sheared(law, np.array([1, -0.9, 0.5, -0.3, 0.2, -0.95, 1.4]) * a, steps)
    turn = tau[steps * np.arange(8)]
    assert max(test["reversals"]) == 2

    def branch(start, stress, end):
        return stress + 2 * backbone((end - start) / 2)

    for k, end in ((3, 0.5), (4, -0.3), (5, 0.2)):
        assert turn[k] == pytest.approx(branch(-0.9 * a, turn[2], end * a))
    assert turn[6] == pytest.approx(branch(a, turn[1], -0.95 * a))
    assert turn[7] == pytest.approx(backbone(1.4 * a))


def called(law, stress, state, de, components=6, R=None):
    """Stress, state and tangent of calls at points."""
    work = law.work(stress, state, components)
    work[:, DE : DE + components] = de
    if R is not None:
        work[:, DROT : DROT + 9] = R.T.ravel()
    assert (law.call(work, components) == 0).all()
    D = work[:, DDSDDE : DDSDDE + components**2].reshape(-1, components, components)
    return (
        work[:, STRESS : STRESS + components].copy(),
        work[:, STATEV : STATEV + state.shape[1]].copy(),
        D.swapaxes(1, 2).copy(),
    )


def history(law, n=300, steps=12, components=6):
    """Points after random increments in three dimensions."""
    rng = np.random.default_rng(2)
    stress = np.zeros((n, components))
    stress[:, :3] = -20e3
    state = law.first_state(np.zeros((n, 3)))
    for _ in range(steps):
        de = rng.normal(size=(n, components)) * 10 ** rng.uniform(-6, -3, (n, 1))
        de[:, :3] -= 0.95 * de[:, :3].mean(axis=1, keepdims=True)
        before = stress, state, de
        stress, state, _ = called(law, stress, state, de, components)
    return before


@pytest.mark.parametrize("components", [4, 6])
@pytest.mark.parametrize(
    "law",
    [
        soil(),
        soil(reversals=2),
        soil(cohesion=2e3, friction_angle=30.0, exponent=0.5),
        soil(cohesion=3e3),
    ],
)
def test_tangents_are_derivatives_also_where_loops_close(law, components):
    stress, state, de = history(law, components=components)
    _, end, D = called(law, stress, state, de, components)
    level = state[:, 6]
    assert (end[:, 6] < level).any()
    assert (end[:, 6] > level).any()
    errors = np.zeros(len(de))
    kept = np.ones(len(de), bool)
    for j in range(components):
        h = 1e-5 * np.abs(de).max(axis=1, keepdims=True) * np.eye(components)[j]
        sides = [called(law, stress, state, de + s * h, components) for s in (1, -1)]
        for side in sides:
            kept &= side[1][:, 6] == end[:, 6]
        slope = (sides[0][0] - sides[1][0]) / (2 * np.abs(h).max(axis=1, keepdims=True))
        errors = np.maximum(errors, np.abs(slope - D[:, :, j]).max(axis=1))
    errors /= np.abs(D).max(axis=(1, 2))
    assert kept.mean() > 0.95
    # at a few points the cone begins between the sides of a difference
    assert np.quantile(errors[kept], 0.99) < 1e-6
    assert law.check(tolerance=1e-5, components=components) == []


def test_memory_turns_with_the_material():
    law = soil(cohesion=2e3, friction_angle=30.0)
    stress, state, de = history(law, n=20)
    plain = called(law, stress, state, de)
    R = special_ortho_group.rvs(3, random_state=1)

    def turned(values, shear=1.0):
        full = np.zeros((len(values), 3, 3))
        full[:, ROWS, COLUMNS] = full[:, COLUMNS, ROWS] = values * [1, 1, 1, *[1 / shear] * 3]
        return (R @ full @ R.T)[:, ROWS, COLUMNS] * [1, 1, 1, *[shear] * 3]

    # a UMAT gets the stress and the increment in turned axes, and turns its own state
    found = called(law, turned(stress), state, turned(de, 2.0), R=R)
    assert found[0] == pytest.approx(turned(plain[0]), rel=1e-9, abs=1e-4)
    for start in range(0, state.shape[1] - 1, 6):
        columns = slice(start + bool(start), start + bool(start) + 6)
        assert found[1][:, columns] == pytest.approx(turned(plain[1][:, columns]), abs=1e-15)


def test_the_cone_bounds_the_stress_and_unloading_is_stiff():
    c, phi, P = 1e3, 30.0, 10e3
    law = soil(cohesion=c, friction_angle=phi)
    _, tau, test = sheared(law, [5e-3, 4.99e-3], 200, pressure=P)
    # Mohr and Coulomb in plane strain without dilatancy: τ = c cos φ + p sin φ
    strength = c * math.cos(math.radians(phi)) + P * math.sin(math.radians(phi))
    xi = 3 / math.sqrt(3 + math.sin(math.radians(phi)) ** 2) / math.sqrt(3)
    assert tau.max() == pytest.approx(strength * xi, rel=1e-6)
    gamma = np.array(test["strain_xy"])
    unloading = (tau[201] - tau[200]) / (gamma[201] - gamma[200])
    assert unloading == pytest.approx(G, rel=1e-3)
    pulled = element_test(law, "isotropic", 1e-2, strain="small", pressure=P)
    assert -pulled["p"][-1] == pytest.approx(c / math.tan(math.radians(phi)))


def test_a_first_stress_beyond_the_cone_is_refused():
    """Sand of φ = 38° with K0 = 1 − sin φ: the first step had cut the deviator, in silence."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [range(3), range(3)])
    for phi, inside in ((35.0, True), (38.0, False)):
        law = soil(cohesion=0.0, friction_angle=phi)
        K0 = 1 - math.sin(math.radians(phi))
        points = mpm.fill(grid, mpm.Box((0, 0), (2, 2)), 2, 1800.0)
        first = mpm.geostatic_stress(surface=2.0, weight=18e3, K0=K0)
        given = np.array([-K0, -1.0, -K0]) * 1e5
        if inside:
            mpm.set_stress(law, points, first, strain="small")
            test = element_test(law, "oedometer", -1e-9, stress=given, steps=1)
            assert test["stress_xx"][-1] == pytest.approx(given[0], rel=1e-5)
            continue
        with pytest.raises(StateError, match=r"outside the yield surface \(f = .*larger K0"):
            mpm.set_stress(law, points, first, strain="small")
        assert not points["stress"].any()
        with pytest.raises(StateError, match="outside the yield surface"):
            element_test(law, "oedometer", -1e-9, stress=given)
        points["stress"] = first(points["x"].T)
        V = mpm.Space(grid, "gimp")
        F = mpm.momentum(law, points, V.increment, V.test, strain="small")
        with pytest.raises(StateError, match="outside the yield surface"):
            mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom")).step()


def test_stiffness_follows_pressure():
    law = soil(exponent=0.5)
    for P in (100e3, 400e3):
        gamma, tau, _ = sheared(law, 1e-9, 1, pressure=P)
        assert tau[-1] / gamma[-1] == pytest.approx(G * math.sqrt(P / 100e3), rel=1e-4)


@pytest.mark.parametrize("integrator", [mpm.Newmark, mpm.Explicit])
def test_a_column_swings_at_small_strain_and_is_damped_at_large(integrator):
    """Free shear waves in a column: the period 4 H/√(G/ρ), and decay by loops."""
    H, cells, rho = 10.0, 10, 2000.0
    lines = [np.array([0.0, 1.0]), np.linspace(0, H, cells + 1)]
    grid = mpm.create_lattice(MPI.COMM_WORLD, lines)
    left = {}
    period = 4 * H / math.sqrt(G / rho)
    for speed in (1e-5, 0.1):
        points = mpm.fill(grid, mpm.Box((0, 0), (1, H)), per_cell=2, density=rho)
        points.add_field("velocity", (2,), "m/s")
        shape = np.sin(math.pi / 2 * points["x"][:, 1] / H)
        points["velocity"] = speed * shape[:, None] * [1.0, 0.0]
        V = mpm.Space(grid, "linear")
        bcs = mpm.fixed(V, "bottom") + mpm.prescribed(V, lambda x: x[0] > -1, 1)
        F = mpm.momentum(soil(), points, V.increment, V.test, strain="small")
        problem = integrator(F, V.increment, points, bcs)
        for k in range(1, 41):
            problem.step(k / 40 * period)
        mass = points["density"] * points["V0"]
        left[speed] = (mass * shape) @ points["velocity"][:, 0] / (mass @ shape**2) / speed
    assert left[1e-5] == pytest.approx(1.0, abs=0.03)
    assert abs(left[0.1]) < 0.7


def test_bad_parameters_are_refused():
    for given, words in (
        ({"cohesion": -1.0}, "cohesion = -1 Pa must be at least 0"),
        ({"cohesion": np.nan}, "cohesion = nan Pa must be at least 0"),
        ({"cohesion": True}, "cohesion = True must be a number"),
        ({"cohesion": 0.0}, "leave no strength"),
        ({"friction_angle": 95.0}, "friction_angle = 95.0 degrees must be in"),
        ({"a": 0.0}, "a = 0.0 must be in"),
        ({"a": lambda x: x[0]}, "takes numbers"),
        ({"reversals": 1}, "reversals = 1"),
    ):
        with pytest.raises(ParameterError, match=words):
            soil(**given)
    assert soil(cohesion=np.int64(3000)).cohesion == 3000.0
