"""Figures that do not depend on the ranks, and the steps that all cases take."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

import dolfinmpm as mpm

COMM = MPI.COMM_WORLD


def sums(points, *names):
    """Weighted sums over all points of the fields, and of their squares."""
    figures = {}
    for name in names:
        values = points[name].reshape(len(points), int(np.prod(points[name].shape[1:])))
        weight = points["V0"] * (1 + points["x0"].sum(axis=1))
        total = COMM.allreduce(weight @ values)
        square = COMM.allreduce(weight @ values**2)
        figures |= {name: list(np.ravel(total)), f"{name} squared": list(np.ravel(square))}
    return figures


def hencky(points, V, ghost=True, E=1e4, nu=0.3):
    """Momentum balance, with ghost penalty."""
    u, v = V.increment, V.test
    F = mpm.momentum(mpm.materials.Hencky(E=E, nu=nu), points, u, v)
    return F + mpm.ghost(points, u, v, gamma=E / 30) if ghost else F


def run(points, V, form, bcs, loads, gravity, **options):
    """Steps to the given loads; returns figures."""
    problem = mpm.QuasiStatic(form, V.increment, points, bcs, **options)
    count, mass = points.total, COMM.allreduce(points["density"] @ points["V0"])
    for load in loads:
        gravity.value[:] = load
        problem.step()
        assert points.total == count
        assert abs(COMM.allreduce(points["density"] @ points["V0"]) - mass) < 1e-12 * mass
    moved = sum(record.migrated for record in problem.history)
    return problem, {
        "iterations": [record.iterations for record in problem.history],
        "unknowns": [record.unknowns for record in problem.history],
        "active_cells": problem.here.active_cells,
        "count": count,
        "moved": (moved > 0) if COMM.size > 1 else None,
        **sums(points, "x", "F", "stress", "l", "V"),
    }
