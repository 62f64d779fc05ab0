"""Scenes of `refinement.py`: a column, a re-entrant corner, a block cut anywhere, random leaves."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm

E, NU = 1e6, 0.3
# of the column: m, N/m³, Pa
HEIGHT, WEIGHT, MODULUS = 50.0, 800.0, 1e4
Figures = dict[str, Any]
Sizes = Callable[[np.ndarray], np.ndarray]


def figures_of(problem: mpm.QuasiStatic, error: float, started: float) -> Figures:
    """Error, size and time of a run."""
    return {
        "error": float(error),
        "unknowns": problem.history[-1].unknowns,
        "points": problem.points.total,
        "newton_iterations": sum(record.iterations for record in problem.history),
        "seconds": time.perf_counter() - started,
    }


def figures_of_footing(figures: Figures) -> Figures:
    """The same figures of a run of `footing.py`."""
    return {
        "error": abs(figures["bearing_error"]),
        **{name: figures[name] for name in ("unknowns", "points", "newton_iterations")},
        "seconds": figures["seconds_setup"] + figures["seconds_solve"],
    }


def settled(depth: float, load: float) -> float:
    """Exact height (m) of a layer of `column`, at first so high, under a part of the weight."""
    from scipy.special import lambertw

    Y = np.linspace(0, depth, 400)
    stretch = np.exp(-lambertw(load * WEIGHT * (HEIGHT - Y) / MODULUS).real)
    return float(np.trapezoid(stretch, Y))


def column(h: float, levels: int = 0, steps: int = 40, graded: bool = False) -> Figures:
    """A column under its weight: error of its stress, as `column_compaction.py` takes it.

    The base is compressed to a third, so that the stress changes fastest per metre there. Leaves
    of one size go down with their soil, so that no point comes to smaller ones and splits.

    Args:
        h: Size of the cells, or of the leaves of the lowest eighth (m).
        levels: How often cells are halved at the base.
        steps: Steps of the load.
        graded: As many lines, from 2/3 as far apart at the base to 4/3 at the top.
    """
    started, root, wide, load = time.perf_counter(), h * 2**levels, HEIGHT / 4, 0.0
    lines = [np.linspace(0, end, round(end / root) + 1) for end in (wide, HEIGHT)]
    if graded:
        lines[1] = lines[1] * (2 + lines[1] / HEIGHT) / 3
    grid = mpm.create_lattice(MPI.COMM_WORLD, lines)

    def size(x: np.ndarray) -> np.ndarray:
        # a cell that has larger points in it stays as it is
        ends = [
            settled(HEIGHT / 2 ** (levels + 1 - k), load) - h * 2 ** (k + 1) for k in range(levels)
        ]
        return np.asarray(1.3 * h * 2.0 ** np.searchsorted(ends, x[1] - 1e-9 * HEIGHT))

    V = mpm.Space(grid, "gimp", **({"refine": size, "levels": levels} if levels else {}))
    points = mpm.fill(grid, mpm.Box((0, 0), (wide, HEIGHT)), per_cell=2, density=80.0, refine=V)
    gravity = fem.Constant(grid, (0.0, 0.0))
    F = mpm.momentum(mpm.materials.Hencky(E=MODULUS, nu=0.0), points, V.increment, V.test)
    F -= ufl.inner(points.density * gravity, V.test) * points.dX
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation="ghost")
    for load in mpm.steps(steps, label=f"column, h = {h:g} m"):
        gravity.value[1] = -WEIGHT / 80 * load
        problem.step()
    exact = -WEIGHT * (HEIGHT - points["x0"][:, 1])
    sums = np.array([points["V0"] @ np.abs(points["stress"][:, 1, 1] - exact), points["V0"].sum()])
    deviation, volume = grid.comm.allreduce(sums)
    return figures_of(problem, deviation / (WEIGHT * HEIGHT * volume), started)


DEGREES = {"linear": 1, "gimp": 1, "bspline2": 2, "bspline3": 3}


class Corner:
    """The leading term of the displacement at a re-entrant corner of 270°, plane strain, mode I.

    Williams 1952 (doi 10.1115/1.4010553). The exponent solves sin(1.5 π λ) = λ. Q follows from a
    stress without traction on the sides of the corner. Both are found numerically.

    Attributes:
        exponent: λ of the displacement r^λ (-).
    """

    def __init__(self) -> None:
        from scipy.optimize import brentq

        self.exponent = brentq(lambda a: math.sin(1.5 * math.pi * a) - a, 0.5, 0.6, xtol=1e-15)
        # the stress is linear in Q
        side = np.array([0.75 * math.pi])
        hoop = [self._polar(side, q)[0] for q in (0.0, 1.0)]
        self._q = float(hoop[0] / (hoop[0] - hoop[1]))
        assert abs(self._polar(side, self._q)[1]) < 1e-12

    def _polar(self, angle: np.ndarray, q: float) -> tuple[float, float]:
        """Hoop and shear stress on a ray."""
        s = self._stress(np.ones(1), angle, q)[0]
        n = np.array([-np.sin(angle[0]), np.cos(angle[0])])
        t = np.array([np.cos(angle[0]), np.sin(angle[0])])
        return float(n @ s @ n), float(t @ s @ n)

    def _stress(self, r: np.ndarray, a: np.ndarray, q: float) -> np.ndarray:
        lam = self.exponent
        b = q * (lam + 1)
        c1, c3 = np.cos((lam - 1) * a), np.cos((lam - 3) * a)
        s1, s3 = np.sin((lam - 1) * a), np.sin((lam - 3) * a)
        xx, yy = (2 - b) * c1 - (lam - 1) * c3, (2 + b) * c1 + (lam - 1) * c3
        xy = (lam - 1) * s3 + b * s1
        result = np.array([[xx, xy], [xy, yy]]) * lam * r ** (lam - 1)
        return np.asarray(np.moveaxis(result, -1, 0))

    # the corner opens along the ray at -45°, its axis of symmetry points to 135°
    _TURN = 0.75 * math.pi

    def _at(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Distance, angle from the axis in (-π, π], and the axes as columns."""
        angle = (np.arctan2(x[1], x[0]) - self._TURN + math.pi) % (2 * math.pi) - math.pi
        c, s = math.cos(self._TURN), math.sin(self._TURN)
        return np.hypot(x[0], x[1]), angle, np.array([[c, -s], [s, c]])

    def displacement(self, x: np.ndarray, size: float) -> np.ndarray:
        """Displacements (m) at positions, both of shape (2, n); `size` (Pa) scales the stress."""
        lam, kappa, G = self.exponent, 3 - 4 * NU, E / (2 + 2 * NU)
        r, a, axes = self._at(x)
        b = self._q * (lam + 1)
        u = (kappa - b) * np.cos(lam * a) - lam * np.cos((lam - 2) * a)
        v = (kappa + b) * np.sin(lam * a) + lam * np.sin((lam - 2) * a)
        return np.asarray(size / (2 * G) * r**lam * (axes @ np.array([u, v])))

    def stress(self, x: np.ndarray, size: float) -> np.ndarray:
        """Stress (Pa) in the plane, shape (n, 2, 2)."""
        r, a, axes = self._at(x)
        return np.asarray(size * axes @ self._stress(r, a, self._q) @ axes.T)


def energy(stress: np.ndarray) -> np.ndarray:
    """Twice the elastic energy density of plane stresses under plane strain (Pa), shape (n,)."""
    G = E / (2 + 2 * NU)
    trace = np.trace(stress, axis1=1, axis2=2)
    return np.asarray((np.sum(stress**2, axis=(1, 2)) - NU * trace**2) / (2 * G))


def corner(n: int, kind: str, basis: str = "gimp") -> Figures:
    """An L-shaped body with the exact displacement on its outer sides: error of its energy norm.

    Args:
        n: Number of cells along a leg of 1 m.
        kind: "uniform"; "refined", leaves of size r^(1 − 1/2p)/n for functions of degree p at a
            distance r from the corner, down to n^(−2p); "graded", lines of a lattice at ± (k/n)².
        basis: Basis of the displacement.
    """
    started, exact, size = time.perf_counter(), Corner(), 1e-3
    p = DEGREES[basis]
    ends = np.linspace(-1, 1, 2 * n + 1)
    lines = np.sign(ends) * ends**2 if kind == "graded" else ends
    grid = mpm.create_lattice(MPI.COMM_WORLD, [lines, lines])
    levels = math.ceil((2 * p - 1) * math.log2(n)) if kind == "refined" else 0

    def wanted(x: np.ndarray) -> np.ndarray:
        apart = np.maximum(np.hypot(x[0], x[1]), float(n) ** (-2 * p))
        return np.asarray(apart ** (1 - 0.5 / p) / n * 1.0001)

    V = mpm.Space(grid, basis, **({"refine": wanted, "levels": levels} if levels else {}))
    shape = mpm.Polygon([(-1, -1), (0, -1), (0, 0), (1, 0), (1, 1), (-1, 1)])
    points = mpm.fill(grid, shape, per_cell=2, density=1.0, refine=V)
    F = mpm.momentum(mpm.materials.Hencky(E, NU), points, V.increment, V.test, strain="small")

    def outer(x: np.ndarray) -> np.ndarray:
        return np.asarray(np.max(np.abs(x[:2]), axis=0) > 1 - 1e-9)

    bcs = [
        condition
        for k in range(2)
        for condition in mpm.prescribed(
            V, outer, k, increment=lambda x, k=k: exact.displacement(x[:2], size)[k]
        )
    ]
    problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation="none")
    problem.step()
    true = exact.stress(points["x0"].T, size)
    gap = points["stress"][:, :2, :2] - true
    sums = np.array([points["V0"] @ energy(field) for field in (gap, true)])
    wrong, whole = grid.comm.allreduce(sums)
    return figures_of(problem, math.sqrt(wrong / whole), started)


def cut_block(k: int, gdim: int, stabilisation: str, basis: str = "gimp") -> float:
    """κ(K) of a block whose upper side cuts leaves of several sizes, the k-th of random places."""
    rng = np.random.default_rng(k)
    centre = np.append(rng.uniform(1, 3, gdim - 1), 2.3)[:, None]
    top = 2.0 + 10 ** rng.uniform(-4, -0.3) if k % 2 else rng.uniform(2.01, 2.9)
    grid = mpm.create_lattice(MPI.COMM_SELF, [np.linspace(0, 4, 5)] * gdim)

    def size(x: np.ndarray) -> np.ndarray:
        return np.where(np.linalg.norm(x - centre, axis=0) < 0.6, 0.25, 1.0)

    V = mpm.Space(grid, basis, refine=size, levels=2)
    box = mpm.Box((0,) * gdim, (4,) * (gdim - 1) + (top,))
    points = mpm.fill(grid, box, per_cell=2, density=1e3, refine=V)
    F = mpm.momentum(mpm.materials.Hencky(E, NU), points, V.increment, V.test)
    sides = ("left", "right") if gdim == 2 else ("left", "right", "front", "back")
    bcs = mpm.rollers(V, *sides) + mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation=stabilisation)
    return float(mpm.study.condition_number(problem.stiffness()))


def patch(k: int, gdim: int, stabilisation: str, basis: str = "gimp") -> float:
    """Largest error of a homogeneous deformation, relative, on the k-th of random trees.

    The upper side of the block cuts leaves, but those of its last root are held.
    """
    rng = np.random.default_rng(k)
    centres, sizes = rng.uniform(0, 4, (3, gdim)), 2.0 ** -rng.integers(1, 4, 3)
    top, A = rng.uniform(2.5, 3.9), 1e-3 * rng.normal(size=(gdim, gdim))
    grid = mpm.create_lattice(MPI.COMM_SELF, [np.linspace(0, 4, 5)] * gdim)

    def size(x: np.ndarray) -> np.ndarray:
        apart = np.linalg.norm(x.T[:, None] - centres, axis=2)
        return np.asarray(np.minimum(sizes + np.maximum(apart - 0.3, 0), 1).min(axis=1) * 1.01)

    V = mpm.Space(grid, basis, refine=size, levels=3)
    box = mpm.Box((0,) * gdim, (4,) * (gdim - 1) + (top,))
    points = mpm.fill(grid, box, per_cell=2, density=1e3, refine=V)
    F = mpm.momentum(mpm.materials.Hencky(E, NU), points, V.increment, V.test)

    # splines of the last root have their Greville points below it, too
    lowest = top - 1 if DEGREES[basis] == 1 else math.floor(top) - 0.51 * (DEGREES[basis] - 1)

    def held(x: np.ndarray) -> np.ndarray:
        outside = np.any((x < 1e-9) | (x > 4 - 1e-9), axis=0)
        return np.asarray(outside | (x[gdim - 1] > lowest))

    bcs = [
        condition
        for i in range(gdim)
        for condition in mpm.prescribed(V, held, i, increment=lambda x, i=i: A[i] @ x[:gdim])
    ]
    problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation=stabilisation)
    x = points["x"].copy()
    problem.step()
    return float(np.abs(points["x"] - x - x @ A.T).max() / np.abs(x @ A.T).max())
