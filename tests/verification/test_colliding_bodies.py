"""Deformable bodies that collide, by explicit steps, against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
import ufl
from conftest import COMM
from dolfinx import mesh

import dolfinmpm as mpm

E, RHO = 1e4, 1000.0


def bodies(grid, shapes, law, basis="gimp", gravity=None, bcs=None, **contact):
    """An explicit problem of bodies that collide, with tags from 1."""
    parts = [mpm.fill(grid, s, 2, RHO, tag=k) for k, s in enumerate(shapes, 1)]
    points = sum(parts[1:], parts[0])
    V = mpm.Space(grid, basis)
    F = mpm.momentum(law, points, V.increment, V.test)
    if gravity is not None:
        F -= ufl.inner(points.density * ufl.as_vector(gravity), V.test) * points.dX
    points.add_field("velocity", (2,), "m/s")
    collision = mpm.Collision(tuple(range(1, len(shapes) + 1)), **contact)
    return mpm.Explicit(
        F, V.increment, points, () if bcs is None else bcs(V), collision=collision, courant=0.5
    )


def mean_velocity(points, tag):
    own = points["tag"] == tag
    m = np.where(own, points["density"] * points["V0"], 0.0)
    return (m @ points["velocity"]) / m.sum()


@pytest.mark.parametrize("basis", ["gimp", "bspline2"])
def test_two_rods_collide(basis):
    """Each as at a rigid wall: the stress ρ c v for the time 2 L/c, and back with the speed.

    They meet at 0.3 of a cell, a quarter of one apart at first.
    """
    h, L, v0, gap = 0.1, 2.0, 0.05, 0.025
    c = math.sqrt(E / RHO)
    grid = mesh.create_rectangle(COMM, [(0, 0), (44 * h, 2 * h)], (44, 2),
                                 mesh.CellType.quadrilateral)  # fmt: skip
    middle = 2.23
    shapes = [mpm.Box((middle - L, 0), (middle, 2 * h)),
              mpm.Box((middle + gap, 0), (middle + gap + L, 2 * h))]  # fmt: skip
    problem = bodies(
        grid, shapes, mpm.materials.Hencky(E=E, nu=0.0), basis, gap_test=True,
        bcs=lambda V: mpm.rollers(V, "bottom", "top"),
    )  # fmt: skip
    points = problem.points
    points["velocity"][:, 0] = np.where(points["tag"] == 1, v0, -v0)
    touch, lasts = 0.5 * gap / v0, 2 * L / c
    force, t = [], []
    for now in np.linspace(0, touch + 1.4 * lasts, 141)[1:]:
        problem.step(float(now))
        force.append(-problem.collision_force[0])
        t.append(now)
    force, t = np.array(force), np.array(t)
    exact = RHO * c * v0 * 2 * h
    during = (t > touch + 0.15 * lasts) & (t < touch + 0.85 * lasts)
    assert force[during].mean() == pytest.approx(exact, rel=0.03)
    impulse = np.trapezoid(force, t)
    assert impulse == pytest.approx(2 * RHO * L * 2 * h * v0, rel=0.1)
    felt = t[np.flatnonzero(force > 0.3 * exact)[0]]
    # within a twentieth of a cell
    assert abs(felt - touch) * 2 * v0 < 0.05 * h + 2 * v0 * (t[1] - t[0])
    back = mean_velocity(points, 1)[0]
    assert back == pytest.approx(-v0, rel=0.1)
    np.testing.assert_allclose(problem.momentum()[0], 0.0, atol=1e-12 * exact)
    assert abs(problem.energies().kinetic / (RHO * L * 2 * h * v0**2) - 1) < 0.15


@pytest.mark.parametrize("friction", [0.0, 0.2])
def test_a_block_slides_on_another(friction):
    """It loses μ g of its velocity a second; without friction none."""
    h, g, v0 = 0.1, 10.0, 0.6
    grid = mesh.create_rectangle(COMM, [(0, 0), (1.4, 1.0)], (14, 10), mesh.CellType.quadrilateral)
    shapes = [mpm.Box((0, 0), (1.4, 0.3)), mpm.Box((0.3, 0.3), (0.8, 0.6))]
    law = mpm.materials.Hencky(E=1e6, nu=0.0)
    problem = bodies(
        grid, shapes, law, gravity=(0.0, -g), friction=friction,
        bcs=lambda V: mpm.fixed(V, "bottom") + mpm.rollers(V, "left", "right"),
    )  # fmt: skip
    points = problem.points
    mpm.set_stress(law, points, lambda x: _settled(x, g))
    points["velocity"][:, 0] = np.where(points["tag"] == 2, v0, 0.0)
    end = 0.2
    problem.step(end)
    left = mean_velocity(points, 2)[0]
    lost = friction * g * end
    # at the block's ends normals are aslant, for it has a corner there
    assert left == pytest.approx(v0 - lost, abs=0.05 * lost + 3e-3 * v0)
    # it stays where it lies, but for what a node may lack of being filled
    bottom = (points["x"] - points["l"])[points["tag"] == 2, 1].min()
    assert abs(bottom - 0.3) < 0.05 * h


def _settled(x, g):
    """Vertical stress under the weight of what is above (Pa), shape (n, 3, 3)."""
    stress = np.zeros((x.shape[1], 3, 3))
    under = (x[0] > 0.3) & (x[0] < 0.8)
    top = np.where(under, 0.6, 0.3)
    stress[:, 1, 1] = -RHO * g * (top - x[1])
    return stress


def test_two_discs_collide():
    """When they touch, and the least kinetic energy; conforming elements on a disc at a plane."""
    R, speed = 0.2, 0.1 * math.sqrt(2)
    grid = mesh.create_rectangle(COMM, [(-0.6, -0.6), (0.6, 0.6)], (24, 24),
                                 mesh.CellType.quadrilateral)  # fmt: skip
    along, apart = np.array([1.0, 1.0]) / math.sqrt(2), 0.35 * math.sqrt(2)
    shapes = [mpm.Ball(-0.5 * apart * along, R), mpm.Ball(0.5 * apart * along, R)]
    problem = bodies(grid, shapes, mpm.materials.NeoHookean(E=1000.0, nu=0.3))
    points = problem.points
    points["velocity"] = np.where(points["tag"][:, None] == 1, 1.0, -1.0) * speed * along
    touch = (0.5 * apart - R) / speed
    first = problem.energies().kinetic
    t = np.linspace(0.0, touch + 0.75, 76)[1:]
    kinetic = []
    for now in t:
        problem.step(float(now))
        kinetic.append(problem.energies().kinetic / first)
    kinetic = np.array(kinetic)
    felt = t[np.flatnonzero(kinetic < 0.99)[0]]
    assert abs(felt - touch) < 0.05
    assert kinetic.min() == pytest.approx(0.053, abs=0.015)
    assert t[np.argmin(kinetic)] - touch == pytest.approx(0.518, abs=0.03)
    np.testing.assert_allclose(problem.momentum(), 0.0, atol=1e-12)


@pytest.mark.parametrize("basis", ["linear", "gimp"])
def test_a_collision_makes_no_energy(basis):
    """A box flies at a disc, five cells wide: energy is lost as they meet, and none comes back.

    What comes back with linear functions is of vibrations: points cross cells. With impulses that
    stop the nodes' velocities alone, and not those mapped back, 33 % came back, with GIMP 18 %.
    """
    speed = 0.8
    grid = mesh.create_rectangle(COMM, [(0, 0), (2.4, 1.6)], (24, 16), mesh.CellType.quadrilateral)
    shapes = [mpm.Box((0.61, 0.53), (1.13, 0.97)), mpm.Disc((1.42, 0.83), 0.27)]
    problem = bodies(grid, shapes, mpm.materials.Hencky(E=1e6, nu=0.2), basis)
    points = problem.points
    points["velocity"][:, 0] = np.where(points["tag"] == 1, speed, -speed)
    whole = []
    for now in np.linspace(0, 0.15, 31)[1:]:
        problem.step(float(now))
        e = problem.energies()
        whole.append((e.kinetic + e.strain) / e.initial)
    # the bodies have parted
    assert mean_velocity(points, 1)[0] < -0.3 * speed
    assert np.max(whole - np.minimum.accumulate(whole)) < 0.005
    assert np.min(whole) > 0.75
