"""The conforming reference: its own checks, and that its stored curves can be had again."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from reference.conforming import Body
from reference.conforming_mesh import Mesh
from reference.footings import cam_clay, rigid_tresca, stored, tresca
from scipy.special import lambertw

from dolfinmpm.materials import CamClay, Hencky, Tresca

STRAINS = pytest.mark.parametrize("strain", ["large", "small"])


def bent(x):
    """Move the inside of the unit square, so that elements are no parallelograms."""
    bump = x[:, 0] * (1 - x[:, 0]) * x[:, 1] * (1 - x[:, 1])
    return x + bump[:, None] * np.stack([np.sin(3 * x[:, 1]), np.sin(1 + 4 * x[:, 0])], axis=1)


def square(law, strain, sides=("bottom", "right", "top", "left")):
    mesh = Mesh(np.linspace(0, 1, 4), np.linspace(0, 1, 3), bent)
    fixed = np.zeros(mesh.x.shape, bool)
    for side in sides:
        fixed[mesh.nodes(side)] = True
    return Body(mesh, law, strain, fixed)


@pytest.mark.parametrize(
    "law",
    [
        Hencky(E=1e3, nu=0.3),
        Tresca(E=1e3, nu=0.33, cohesion=10.0, ultimate_cohesion=15.0),
        CamClay(
            swelling=0.018,
            compression=0.13,
            M=1.05,
            mu0=5400.0,
            alpha=0.0,
            reference_pressure=20.0,
            preconsolidation=20.0,
        ),
    ],
    ids=lambda law: type(law).__name__,
)
@STRAINS
def test_tangent_is_the_derivative(law, strain):
    body = square(law, strain, ())
    rng = np.random.default_rng(0)
    first, second, way = rng.uniform(-0.01, 0.01, (3, *body.mesh.x.shape))
    body.state = body._evaluate(first)[0]
    _, _, K = body._evaluate(second, tangent=True)
    step = 1e-5
    ahead, behind = (body._evaluate(second + s * way)[1] for s in (step, -step))
    expected = (ahead - behind) / (2 * step)
    found = np.einsum("eij,ej->ei", K, way.ravel()[body.unknowns])
    assert np.abs(found - expected).max() < 1e-6 * np.abs(expected).max()


@STRAINS
def test_patch(strain):
    """A linear displacement of the border gives the same strain everywhere."""
    law = Hencky(E=1e3, nu=0.3)
    body = square(law, strain)
    H = np.array([[0.10, 0.05], [-0.20, -0.15]])
    nothing = np.zeros_like(body.mesh.x)
    body.step(nothing, body.mesh.x @ H.T)
    np.testing.assert_allclose(body.state.u, body.mesh.x @ H.T, atol=1e-12)
    np.testing.assert_allclose(body.state.F, np.tile(np.eye(2) + H, (24, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(body.state.stress, body.state.stress[:1].repeat(24, 0), atol=1e-9)


def test_rotation_changes_no_stress_but_its_axes():
    body = square(Hencky(E=1e3, nu=0.3), "large")
    nothing, x = np.zeros_like(body.mesh.x), body.mesh.x
    stretch = np.diag([1.2, 0.9])
    body.step(nothing, x @ (stretch - np.eye(2)).T)
    before = body.state.stress[0, :2, :2]
    for k in range(10):
        angle = 0.2 * (k + 1)
        R = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        body.step(nothing, x @ (R @ stretch - np.eye(2)).T)
    expected = np.tile(R @ before @ R.T, (24, 1, 1))
    np.testing.assert_allclose(body.state.stress[:, :2, :2], expected, atol=1e-9)


def test_column_compacts_to_the_exact_height():
    """Elastic self-weight to less than half the height, by Lambert's function."""
    height, E, weight = 50.0, 1e4, 800.0
    mesh = Mesh([0.0, 1.0], np.linspace(0, height, 41))
    fixed = np.zeros(mesh.x.shape, bool)
    fixed[:, 0] = True
    fixed[mesh.nodes("bottom")] = True
    body = Body(mesh, Hencky(E=E, nu=0.0), "large", fixed)
    for k in range(40):
        body.step(mesh.body_load((0.0, -weight * (k + 1) / 40)))
    assert max(body.iterations) <= 5
    s = weight * (height - mesh.x[:, 1]) / E
    w, w0 = np.real(lambertw(s)), np.real(lambertw(weight * height / E))
    exact = E / weight * (w0 + w0**2 / 2 - w - w**2 / 2)
    np.testing.assert_allclose(mesh.x[:, 1] + body.state.u[:, 1], exact, atol=2e-5)


def test_pressure_that_follows_stays_normal():
    """Uniform pressure all round is in equilibrium with the shape that it leaves."""
    body = square(Hencky(E=1e3, nu=0.3), "large", ())
    mesh = body.mesh
    L = sum(mesh.follower(side, -1.0, 2.0) for side in mesh.sides)
    dead = sum(mesh.edge_load(side, lambda x, n: -n) for side in mesh.sides)
    first = body._gather(np.einsum("eij,ej->ei", L, mesh.x.ravel()[body.unknowns]))
    np.testing.assert_allclose(first, dead.ravel(), atol=1e-14)
    body.fixed[np.flatnonzero((mesh.x == 0).all(axis=1))[0] * 2 + np.arange(2)] = True
    body.fixed[np.flatnonzero((mesh.x == (1, 0)).all(axis=1))[0] * 2 + 1] = True
    body._prepare()
    pressure = 200.0
    body.step(np.zeros_like(mesh.x), None, pressure * L)
    J = np.linalg.det(body.state.F)
    np.testing.assert_allclose(body.state.stress[:, 0, 0] / J, -pressure, rtol=1e-9)
    np.testing.assert_allclose(body.state.stress[:, 0, 1], 0.0, atol=1e-7)


@pytest.mark.parametrize("share", [0.5, 0.9])
def test_thick_cylinder(share):
    """Internal pressure on a tube of Tresca's law, plastic out to c, against Hill."""
    a, b, E, nu, Y = 0.1, 0.2, 210e9, 0.3, 2 * 0.24e9 / math.sqrt(3)
    c = a + share * (b - a)
    p = Y * (math.log(c / a) + (1 - (c / b) ** 2) / 2)

    def polar(x):
        return np.stack([x[:, 0] * np.sin(x[:, 1]), -x[:, 0] * np.cos(x[:, 1])], axis=1)

    # from the radius −y to the radius x: angles rise against the clock
    mesh = Mesh(np.linspace(a, b, 17), np.linspace(0, math.pi / 2, 13), polar)
    fixed = np.zeros(mesh.x.shape, bool)
    fixed[mesh.nodes("bottom"), 0] = fixed[mesh.nodes("top"), 1] = True
    body = Body(mesh, Tresca(E=E, nu=nu, cohesion=Y / 2), "small", fixed)
    unit = mesh.edge_load("left", lambda x, n: -n)
    for k in range(10):
        body.step(p * (k + 1) / 10 * unit)
    outer = np.linalg.norm(body.state.u[mesh.nodes("right")], axis=1)
    assert outer == pytest.approx(Y * c**2 * (1 - nu**2) / (E * b), rel=2e-3)


@pytest.mark.parametrize(
    ("rough", "finest", "tolerance"),
    [(False, 0.1, 0.015), pytest.param(True, 0.05, 0.015, marks=pytest.mark.long)],
)
def test_prandtl(rough, finest, tolerance):
    """The limit pressure (2 + π) c, from above; rough or smooth is the same to the exact one."""
    curve = rigid_tresca(0.5, rough=rough, finest=finest, depth=0.75)
    limit = (2 + math.pi) * 10e3
    assert limit < curve.load[-1] < (1 + tolerance) * limit
    # it is reached: the last tenth of the settlement adds next to nothing
    assert curve.load[-1] - curve.load[-4] < 1e-3 * limit


@pytest.mark.long
@pytest.mark.parametrize(("scene", "run"), [("cam_clay", cam_clay), ("tresca", tresca)])
@STRAINS
def test_stored_curves_can_be_had_again(scene, run, strain):
    h = 0.5
    curve = run(h, strain)
    assert curve.complete
    load, centre, mean, edge = stored(scene, strain, h)
    np.testing.assert_allclose(curve.load, load, rtol=1e-9)
    for found, expected in ((curve.centre, centre), (curve.mean, mean), (curve.edge, edge)):
        np.testing.assert_allclose(found, expected, atol=1e-6 * centre[-1])


@STRAINS
def test_stored_curves_of_cam_clay_converge(strain):
    """The centre's settlement is known to 0.1 %, the mean to 0.5 %, at every load.

    Under large strain the finest grid finds no equilibrium beyond 73.8 kPa: its elements at
    the footing's edge, where the load jumps, are too far deformed.
    """
    curves = [stored("cam_clay", strain, h)[:3] for h in (0.5, 0.25, 0.125)]
    assert curves[0][0, -1] == curves[1][0, -1] == 90e3
    assert curves[2][0, -1] > 70e3
    for coarse, fine in itertools.pairwise(curves):
        common = coarse[:, : fine.shape[1]]
        np.testing.assert_array_equal(common[0], fine[0])
        assert np.abs(common[1] - fine[1]).max() < 1e-3 * fine[1, -1]
        assert np.abs(common[2] - fine[2]).max() < 5e-3 * fine[2, -1]


@pytest.mark.parametrize(("scene", "least"), [("cam_clay", 1.25), ("tresca", 1.5)])
def test_small_strain_overestimates_the_settlement(scene, least):
    large, small = (stored(scene, strain, 0.25) for strain in ("large", "small"))
    assert (small[1:3, 1:] > large[1:3, 1:]).all()
    assert (small[1:3, -1] > least * large[1:3, -1]).all()


def test_stored_curves_of_tresca_converge_up_to_56_kilopascals():
    """Beyond, the ground beside the footing's edge stretches without end as h falls."""
    curves = {h: stored("tresca", "large", h) for h in (0.5, 0.25, 0.125)}
    at = np.searchsorted(curves[0.5][0], 56e3 - 1)
    settlements = [curve[1, at] for curve in curves.values()]
    assert settlements[0] < settlements[1] < settlements[2] < 1.015 * settlements[0]
