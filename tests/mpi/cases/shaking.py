"""Ground in an earthquake: tied sides, and waves that come in, on any number of ranks."""

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
