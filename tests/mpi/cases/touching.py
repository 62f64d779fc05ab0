"""Bodies with fields of their own that touch across the borders of ranks."""

from __future__ import annotations

import numpy as np
import ufl
from dolfinx import fem, mesh
from scenes import two_blocks

import dolfinmpm as mpm

from .common import COMM, sums
from .restart import REPEATABLE, goes_on


def rubbed(**options):
    """A block is pressed onto another, and drawn along it by springs."""
    points, (low, up), F, _ = two_blocks(0.3, upper=(0.4, 2.2), moduli=(1e4, 1e4))
    weight, place = fem.Constant(points.grid, (0.0, 0.0)), fem.Constant(points.grid, 0.0)
    u, v = up.increment, up.test
    way = u[0] + (points.x - points.x0)[0] - place
    F += (1e3 * way * v[0] - ufl.dot(weight, v)) * points.dX(2)
    increments = [low.increment, u]
    bcs = mpm.fixed(low, "bottom")
    problem = mpm.QuasiStatic(F, increments, points, bcs, stabilisation="ghost", **options)

    def step():
        weight.value[1], place.value = -20.0, 0.04 * len(problem.history)
        return problem.step()

    return problem, step


def figures(problem):
    (contact,) = problem.form.parts.terms
    markers = contact.boundaries[0].markers
    return {
        "force": problem.history[-1].bodies[contact.name]["force"],
        "dissipated": contact.dissipated,
        "iterations": [record.iterations for record in problem.history],
        "forces": list(COMM.allreduce(markers[contact.names.tangential_force].sum(axis=0))),
        "unknowns": [record.unknowns for record in problem.history],
        **sums(problem.points, "x", "F", "stress"),
    }


def bodies_that_rub():
    """Slip and friction; the force is Coulomb's."""
    problem, step = rubbed(tolerance=1e-12)
    for _ in range(6):
        step()
    found = figures(problem)
    assert abs(found["force"][0] / found["force"][1] + 0.3) < 3e-3
    return found


def touching_restart():
    """A run that is broken off while the block slides."""
    return goes_on(lambda: rubbed(petsc_options=REPEATABLE, tolerance=1e-12), 6, moves=False)


def bodies_that_collide():
    """Two discs that fly at each other, in time, and change ranks on their way."""
    grid = mesh.create_rectangle(COMM, [(-1, -1), (1, 1)], (10, 10), mesh.CellType.quadrilateral)
    turn = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    rim = 0.4 * np.column_stack([np.cos(turn), np.sin(turn)])
    along = np.array([1.0, 0.6]) / np.hypot(1.0, 0.6)
    centres = -0.43 * along, 0.43 * along
    discs = [mpm.fill(grid, mpm.Ball(x, 0.4), 2, 1e3, tag=k + 1) for k, x in enumerate(centres)]
    points = discs[0] + discs[1]
    spaces = [mpm.Space(grid, "gimp", tag=k) for k in (1, 2)]
    u, v = [V.increment for V in spaces], [V.test for V in spaces]
    law = mpm.materials.Hencky(E=1e3, nu=0.4)
    F = sum(mpm.momentum(law, points, u[k], v[k], fbar=True) for k in (0, 1))
    rims = [mpm.Boundary.from_polygon(points, x + rim, rule=1) for x in centres]
    F += mpm.contact_between(rims, u, v, friction=0.2)
    points.add_field("velocity", (2,), "m/s")
    first = points["tag"][:, None] == 1
    points["velocity"] = np.where(first, 1.0, -1.0) * (0.3 * along + [0.0, 0.03])
    problem = mpm.Newmark(F, u, points, stabilisation="ghost", tolerance=1e-12)
    before = problem.momentum()
    spin = problem.angular_momentum()
    carried = 0.3 * COMM.allreduce(float(points["density"] @ points["V0"]))
    for k in range(6):
        problem.step(0.1 * (k + 1))
        np.testing.assert_allclose(problem.momentum(), before, atol=1e-11 * carried)
        # forces on both bodies act at both ends of a gap, and by their functions at the start
        np.testing.assert_allclose(problem.angular_momentum(), spin, atol=4e-4 * carried)
    return {**figures(problem), **sums(points, "velocity")}
