"""Thick shells under internal pressure, axisymmetric: bodies and closed forms.

A long cylinder is a slice of height h between smooth plates, a sphere a quarter of its section
between the axis and the plane of the equator. The grid fits neither of the sphere's circles.
There loads act on a *skin*: points of next to no volume on the two faces, each with its share of
the area. Such a point has the deformation gradient of the face itself, so that a pressure which
follows the face is right to second order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from grids import grid_of_lines
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq

import dolfinmpm as mpm

# Principal stresses across the radial one: 1 of a cylinder in plane strain, 2 of a sphere
ACROSS = {"cylinder": 1, "sphere": 2}
# Volume of a point of the skin, by that of a cell
SKIN = 1e-9


@dataclass
class Shell:
    """The body of a shell.

    Attributes:
        shape: "cylinder" or "sphere".
        a, b: Its radii at first.
        points: Its points; those of a sphere's skin have the tags 1 (inside) and 2 (outside).
        inner, outer: Its surfaces.
        sides: Sides of the grid with rollers.
    """

    shape: str
    a: float
    b: float
    points: mpm.MaterialPoints
    inner: mpm.Surface
    outer: mpm.Surface
    sides: tuple[str, ...]

    def radius(self, x):
        """Radii of positions, shape (n,), and the directions outwards there, shape (n, 2)."""
        middle = x if self.shape == "sphere" else x * [1.0, 0.0]
        r = np.linalg.norm(middle, axis=1)
        return r, middle / r[:, None]

    def radial(self, x, tensor):
        """Components of tensors of shape (n, 3, 3) along the radii."""
        _, n = self.radius(x)
        return np.einsum("pi,pij,pj->p", n, tensor[:, :2, :2], n)

    def mean_radial(self, surface):
        """Mean of a surface's displacements along its normal, by area. Collective."""
        area = self.points[surface.area.name]
        total = self.points.comm.allreduce(float(np.sum(area * surface.displacements())))
        return total / surface.total_area

    def inside(self, values, reach, power=-1):
        """Value of a field at the inner face: of the skin, or by a parabola. Collective.

        Strain at single points beside a face alternates about what it should be.

        Args:
            values: The field, shape (points,).
            reach: First distance from the face to which points are taken in.
            power: Parabola in R^(-power); small elastic stresses of a shell go by k + 1.
        """
        points = self.points
        if self.shape == "sphere":
            weight = np.linalg.norm(points[self.inner.area.name], axis=1)
            return float(points.comm.allreduce(weight @ values)) / self.inner.total_area
        R = self.radius(points["x0"])[0]
        near = (points["tag"] == 0) & (self.a + reach > R)
        z = (R / self.a) ** -power - 1
        A = np.column_stack([np.ones_like(z), z, z**2])[near]
        square, right = (points.comm.allreduce(A.T @ q) for q in (A, values[near]))
        return float(np.linalg.solve(square, right)[0])


def graded(h, end, even, growth):
    """Lines of a grid from 0 to `end` at least: cells of size h up to `even`, then growing ones."""
    lines = list(h * np.arange(int(np.ceil(even / h - 1e-9)) + 1))
    while lines[-1] < end * (1 - 1e-12):
        h *= growth
        lines.append(lines[-1] + h)
    # an empty cell beyond: at the edge of the grid no cell counts as cut
    return np.array([*lines, lines[-1] + h, lines[-1] + 2 * h])


def skin(radius, size):
    """Positions, and area vectors that point outwards, of parts of a sphere of about that size."""
    ends = np.linspace(0, np.pi / 2, max(4, round(0.5 * np.pi * radius / size)) + 1)
    low, high = ends[:-1], ends[1:]
    # ∫ 2π R cos θ (cos θ, sin θ) R dθ
    along = 0.5 * (high - low) + 0.25 * (np.sin(2 * high) - np.sin(2 * low))
    up = 0.5 * (np.sin(high) ** 2 - np.sin(low) ** 2)
    area = 2 * np.pi * radius**2 * np.column_stack([along, up])
    return radius * area / np.linalg.norm(area, axis=1, keepdims=True), area


def shell(shape, a, b, h, per_cell, room=1.0, even=None, growth=1.0):
    """A shell of radii a and b on a grid of cells of size h. Collective.

    Args:
        shape: "cylinder" or "sphere".
        a, b: Radii.
        h: Size of the cells at the inner face.
        per_cell: Points per cell and direction.
        room: Radius up to which the grid reaches at least, by b.
        even: Radius up to which cells are of size h; everywhere by default.
        growth: Ratio of the sizes of neighbouring cells beyond.
    """
    end = room * b
    lines = graded(h, end, end if even is None else min(even, end), growth)
    if shape == "cylinder":
        grid = grid_of_lines(lines, np.array([0, h]))
        points = mpm.fill(grid, mpm.Box((a, 0), (b, h)), per_cell, 1.0, axisymmetric=True)
        inner = mpm.Surface(points, lambda x: np.isclose(x[0], a), (-1, 0), name="inner")
        outer = mpm.Surface(points, lambda x: np.isclose(x[0], b), (1, 0), name="outer")
        return Shell(shape, a, b, points, inner, outer, ("bottom", "top"))
    grid = grid_of_lines(lines, lines)
    body = mpm.Where(lambda x: (np.hypot(*x[:2]) > a) & (np.hypot(*x[:2]) < b))
    body.volume = 0.25 * np.pi * (b**2 - a**2)
    body.centroid = np.full(2, 4 / (3 * np.pi) * (b**3 - a**3) / (b**2 - a**2))
    points = mpm.fill(grid, body, per_cell, 1.0, exact=True, axisymmetric=True)
    own = points.total
    faces = []
    for tag, radius in ((1, a), (2, b)):
        x, area = skin(radius, (h if even is None else max(h, h * radius / even)) / per_cell)
        faces.append(area * (1 if tag == 2 else -1))
        volume = SKIN * h**2 * 2 * np.pi * x[:, 0]
        points = points + mpm.MaterialPoints.from_arrays(
            grid, x, volume, 1.0, tag=tag, half_length=0.0, id=np.arange(len(x)), axisymmetric=True
        )
    # numbers of points that are joined follow those of the ones before
    every = np.concatenate([np.zeros((own, 2)), *faces])[points["id"]]
    surfaces = []
    for tag, name in ((1, "inner"), (2, "outer")):
        area = np.where(points["tag"][:, None] == tag, every, 0.0)
        surfaces.append(mpm.Surface.from_arrays(points, 0 * area, area, name=name))
    return Shell(shape, a, b, points, *surfaces, ("left", "bottom"))


# -- closed forms -----------------------------------------------------------------


class HenckyShell:
    """Hencky's elastic shell of radii 1 and b under a pressure on the face as it is.

    σ_r' + k (σ_r − σ_θ)/r = 0 with λ_r = dr/dR and λ_θ = r/R, by a Runge–Kutta method from the free
    face inwards, whose radius is sought. In units of Young's modulus.
    """

    def __init__(self, shape, nu, b):
        self.k, self.b = ACROSS[shape], b
        self.lmbda, self.mu = nu / ((1 + nu) * (1 - 2 * nu)), 0.5 / (1 + nu)

    def _stress(self, e_r, e_t):
        """Kirchhoff stresses, radial and hoop."""
        volume = self.lmbda * (e_r + self.k * e_t)
        return volume + 2 * self.mu * e_r, volume + 2 * self.mu * e_t

    def _inwards(self, outer):
        k, M = self.k, self.lmbda + 2 * self.mu

        def slope(R, y):
            r, e_r = y
            e_t, e_t_slope = np.log(r / R), np.exp(e_r) / r - 1 / R
            tau_r, tau_t = self._stress(e_r, e_t)
            balance = k * (tau_t - tau_r) * np.exp(e_r) / r
            return [np.exp(e_r), (balance - k * (self.lmbda - tau_r) * e_t_slope) / (M - tau_r)]

        e_t = np.log(outer / self.b)
        first = [outer, -k * self.lmbda / M * e_t]
        found = solve_ivp(slope, (self.b, 1.0), first, rtol=1e-11, atol=1e-13)
        return found.y[:, -1]

    def __call__(self, ratio):
        """Pressure, outer radius, radial stretch and hoop stress inside at r(a)/a = ratio."""
        k = self.k

        def miss(outer):
            return self._inwards(outer)[0] - ratio

        # more than without a change of volume, less than if all radii grew alike
        low = high = (self.b ** (k + 1) + ratio ** (k + 1) - 1) ** (1 / (k + 1))
        while miss(high) < 0:
            low, high = high, high + 0.02 * (ratio * self.b - high)
        while miss(low) > 0:
            low, high = low - 0.02 * (low - self.b), low
        outer = brentq(miss, low, high, xtol=1e-13)
        r, e_r = self._inwards(outer)
        tau_r, tau_t = self._stress(e_r, np.log(r))
        J = np.exp(e_r) * r**k
        return -tau_r / J, outer, np.exp(e_r), tau_t / J


class TrescaCavity:
    """A cavity of radius 1 in an incompressible Hencky–Tresca body with the outer radius b.

    The volume between two radii stays, r^(k+1) − R^(k+1) = a^(k+1) − 1, so that strains are known,
    and p = ∫ k (σ_θ − σ_r)/r dr with σ_θ − σ_r = min(2 G (e_θ − e_r), 2 c). In units of c.
    """

    def __init__(self, shape, rigidity, b):
        self.k, self.G, self.b = ACROSS[shape], rigidity, b

    def front(self, ratio):
        """First radius of the points that are about to yield, without an outer face."""
        n = self.k + 1
        return ((ratio**n - 1) / np.expm1(1 / self.G)) ** (1 / n)

    def __call__(self, ratio):
        """Pressure, outer radius, radial stretch and hoop stress inside at r(a)/a = ratio."""
        k, n = self.k, self.k + 1
        grown = ratio**n - 1

        def difference(R):
            # e_r = −k e_θ, and e_θ = ln(r/R)
            return min(2 * self.G * np.log1p(grown / R**n), 2.0)

        def integrand(s):
            R = np.exp(s)
            # dr/r = R^n ds / r^n
            return k * difference(R) * R**n / (R**n + grown)

        end = np.log(self.b) if np.isfinite(self.b) else np.log(1e4 * self.front(ratio))
        middle = min(max(np.log(self.front(ratio)), 0.0), end)
        p = quad(integrand, 0, middle, epsabs=1e-12)[0]
        p += quad(integrand, middle, end, epsabs=1e-12)[0]
        outer = (self.b**n + grown) ** (1 / n) if np.isfinite(self.b) else np.inf
        return p, outer, ratio**-k, difference(1.0) - p
