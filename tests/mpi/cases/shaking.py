"""Ground in an earthquake: tied and free-field sides, waves that come in, on several ranks."""

from __future__ import annotations

import functools

import numpy as np

import dolfinmpm as mpm

from .common import COMM, hencky, sums


def _column(kind, axis=0, steps=30, dt=4e-3, **options):
    """Figures of a layer with tied sides that a wave shakes, and that moves along the grid."""
    lines = [np.arange(15.0), np.arange(9.0)]
    grid = mpm.create_lattice(COMM, lines if axis == 0 else lines[::-1])
    low, high = ((4, 0), (7, 8)) if axis == 0 else ((0, 4), (8, 7))
    points = mpm.fill(grid, mpm.Box(low, high), 2, 2000.0)
    V = mpm.Space(grid, "bspline2")
    F = hencky(points, V, ghost=False, E=2e8)
    record = mpm.InputMotion([0.0, 0.02, 0.06, 0.1], velocity=[0.0, 0.1, -0.1, 0.0])
    rock = {"density": 2400.0, "p_speed": 900.0, "s_speed": 500.0}
    wave = (record, record.scaled(0.3))
    bcs = mpm.absorbing(V, "bottom" if axis == 0 else "left", **rock, incoming=wave)
    sides = mpm.tied(V, period=3.0, axis=axis)
    problem = kind(F, V.increment, points, bcs, prolongation=sides, **options)
    # across several cells in the run
    along = np.zeros(2)
    along[axis] = 20.0
    points["velocity"] = along
    for t in mpm.times(steps * dt, dt=dt):
        problem.step(t)
    now = problem.energies()
    return {
        "energies": [now.kinetic, now.strain, now.external, now.losses["damping"]],
        **sums(points, "x", "stress", "velocity"),
    }


def shaking():
    """Newmark's rule and explicit steps, with both masses."""
    newmark = functools.partial(mpm.Newmark, tolerance=1e-12, ghost_mass=0.0)
    return {
        "newmark": _column(newmark),
        "explicit": _column(mpm.Explicit),
        "consistent": _column(mpm.Explicit, 1, 10, mass="consistent", ghost_mass=0.0),
    }


def covered_sides():
    """Narrow bodies at wide absorbing sides, in cut cells; one moves along the side."""
    figures = {}
    ways = {
        "newmark": functools.partial(mpm.Newmark, tolerance=1e-12),
        "explicit": mpm.Explicit,
        "general": functools.partial(mpm.Explicit, fused=False),
    }
    for name, kind in ways.items():
        grid = mpm.create_lattice(COMM, [np.arange(9.0), np.arange(11.0)])
        points = mpm.fill(grid, mpm.Box((0, 2.25), (8, 4.75)), 2, 2000.0)
        V = mpm.Space(grid, "gimp")
        F = hencky(points, V, ghost=False, E=2e8)
        bcs = mpm.absorbing(V, "left", density=2000.0, p_speed=360.0, s_speed=200.0)
        problem = kind(F, V.increment, points, bcs)
        points["velocity"] = (-1.0, 20.0)
        for t in mpm.times(0.08, dt=4e-3):
            problem.step(t)
        now = problem.energies()
        figures[name] = {
            "energies": [now.kinetic, now.strain, now.losses["damping"]],
            **sums(points, "x", "stress", "velocity"),
        }
    return figures


def free_fields():
    """A layer with a hill between free-field sides, in 2D and in 3D, with incoming waves."""
    record = mpm.InputMotion([0.0, 0.02, 0.06, 0.1], velocity=[0.0, 0.1, -0.1, 0.0])
    rock = {"density": 2400.0, "p_speed": 900.0, "s_speed": 500.0}

    def ground(kind, d, width, hill=0.0, sides=None, **options):
        lines = [np.arange(12.0), *([np.arange(3.0)] * (d - 2)), np.arange(7.0)]
        grid = mpm.create_lattice(COMM, lines)
        middle = (2.0,) * (d - 2)
        body = mpm.Box((4,) + (0,) * (d - 1), (4 + width, *middle, 4))
        if hill:
            body |= mpm.Box((5, *(0,) * (d - 2), 4), (5 + hill, *middle, 6))
        points = mpm.fill(grid, body, 2, 2000.0)
        V = mpm.Space(grid, "gimp")
        F = hencky(points, V, ghost=False, E=2e8)
        wave = (record, *(None,) * (d - 1))
        bcs = mpm.absorbing(V, "bottom", **rock, incoming=wave)
        if d == 3:
            bcs += mpm.rollers(V, "front", "back")
        if sides is None:
            options["prolongation"] = mpm.tied(V, period=width)
        else:
            bcs += mpm.free_field(V, "left", "right", column=sides)
        return points, kind(F, V.increment, points, bcs, **options)

    figures = {}
    for name, kind, d in (("newmark", mpm.Newmark, 2), ("explicit", mpm.Explicit, 3)):
        _, beside = ground(mpm.Newmark, d, 1.0, tolerance=1e-12, mass="lumped")
        column = mpm.GroundColumn(beside, 0.08, dt=4e-3)
        options = {"tolerance": 1e-12} if kind is mpm.Newmark else {}
        points, problem = ground(kind, d, 4.0, 2.0, column, **options)
        for t in mpm.times(0.08, dt=4e-3):
            problem.step(t)
        now = problem.energies()
        figures[name] = sums(points, "x", "stress", "velocity")
        figures[name]["energies"] = [now.kinetic, now.external, now.losses["damping"]]
    return figures
