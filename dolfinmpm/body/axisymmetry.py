"""Axisymmetric bodies: points go around the axis x[0] = 0, and gradients have a hoop term.

The coordinates are the radius r = x[0] and the height z = x[1]. An axisymmetric displacement
(u_r, u_z) has the hoop strain u_r/r. In the axes r, z, θ its gradient is

    ∇u = [[∂_r u_r, ∂_z u_r, 0], [∂_r u_z, ∂_z u_z, 0], [0, 0, u_r/r]].

With this gradient all kinematics are the same as in three dimensions. r is the radius at the start
of the step, because gradients are by positions at the start of the step. The hoop component of F is
the product of 1 + u_r/r over the steps: the ratio of the present radius to the first radius.
Averages over domains go around the axis. For u_r/r, the mean of u_r over the section of the domain
is divided by the radius of its centre. Slopes along the radius are weighted by the radius
(`dolfinmpm.basis.lineweights.ring_slopes`).

Volumes (m³), masses (kg), areas of faces (m²), forces (N) and energies (J) are for the whole body:
2π r times the values of the section.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx.mesh import Mesh
from ufl.core.expr import Expr

from dolfinmpm._platform.argumentchecks import shown
from dolfinmpm._platform.errors import ParameterError, UnsupportedGridError
from dolfinmpm.body.location import bounds

if TYPE_CHECKING:
    from dolfinmpm.body.points import MaterialPoints
    from dolfinmpm.body.pointtable import PointTable

__all__ = [
    "checked_radii",
    "deformation",
    "full_gradient",
    "gradient",
    "in_section",
    "require_axis",
    "ring",
    "section",
]

Array = npt.NDArray[np.float64]

# Part of a grid beyond the axis that counts as rounding, relative to the size of the grid
_SLACK = 1e-12


def require_axis(grid: Mesh) -> None:
    """Raise unless a grid can contain an axisymmetric body about x[0] = 0. Collective.

    Raises:
        UnsupportedGridError: The grid is not two-dimensional, or reaches to negative radii.
    """
    if grid.geometry.dim != 2:
        raise UnsupportedGridError(
            f"axisymmetric = True needs a grid of 2 dimensions, radius and height, got "
            f"{grid.geometry.dim}"
        )
    low, high = bounds(grid)
    if low[0] < -_SLACK * np.abs([low, high]).max():
        raise UnsupportedGridError(
            f"axisymmetric = True: the axis is x[0] = 0, and the grid reaches from x[0] = "
            f"{low[0]:g} m; move it, so that it begins at 0 or beyond"
        )


def checked_radii(x: Array) -> None:
    """Raise ParameterError unless the radii of points are positive.

    Args:
        x: Positions (m), shape (n, 2).
    """
    bad = np.flatnonzero(~(x[:, 0] > 0.0))
    if bad.size:
        raise ParameterError(
            f"axisymmetric = True: the point at {x[bad[0]]} m has the radius x[0] = "
            f"{x[bad[0], 0]:g} m, which must be positive: a ring on the axis has no volume "
            f"({bad.size} such points on this rank)"
        )


def ring(radius, amount):
    """Amount around the axis: 2π r times the amount of a section, exact for its centroid's r."""
    return 2 * math.pi * radius * amount


def section(points: PointTable, volume: str, x: str) -> Array:
    """Sizes of the points in the grid: volumes (m^d), or areas of axisymmetric sections (m²).

    Args:
        points: Material points.
        volume: Name of the field of volumes.
        x: Name of the field of positions for these volumes.
    """
    V = points[volume]
    return V / ring(points[x][:, 0], 1.0) if points.axisymmetric else V


def gradient(points: MaterialPoints, w, *, radius: Expr | None = None) -> Expr:
    """Gradient of a displacement or a test function at the points, for UFL.

    The gradient is `ufl.grad(w)`, shape (d, d). At axisymmetric points it has the hoop term w_r/r,
    and shape (3, 3) in the axes r, z, θ. A form with `mpm.gradient` instead of `ufl.grad` is right
    for both. The gradient of a scalar is always `ufl.grad(w)`, shape (d,).

    Args:
        points: Material points.
        w: Increment or test function of a displacement, or of a scalar field.
        radius: r in terms that are not sums over the points; by default the points' radius.

    Raises:
        ParameterError: `points` are no material points, w is no UFL expression, or w has another
            shape at axisymmetric points.

    At axisymmetric points it has the hoop term:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    >>> V = mpm.Space(grid, "gimp")
    >>> mpm.gradient(points, V.increment).ufl_shape
    (2, 2)
    >>> ring = mpm.fill(grid, mpm.Box((1, 0), (4, 2)), 2, density=2000.0, axisymmetric=True)
    >>> mpm.gradient(ring, V.increment).ufl_shape
    (3, 3)
    """
    if not hasattr(points, "strain_dim"):
        raise ParameterError(f"points = {shown(points)} must be material points, see mpm.fill")
    if not isinstance(w, Expr):
        raise ParameterError(
            f"w = {shown(w)} must be a field of UFL, such as Space.increment or Space.test"
        )
    if radius is not None and not isinstance(radius, Expr):
        raise ParameterError(f"radius = {shown(radius)} must be r in UFL, such as points.x[0]")
    G = ufl.grad(w)
    if not points.axisymmetric or w.ufl_shape == ():
        return G
    if w.ufl_shape != (2,):
        raise ParameterError(
            f"w has the shape {w.ufl_shape}, and at axisymmetric points it must be a vector of "
            "radius and height, (2,), or a scalar"
        )
    hoop = w[0] / (points.x[0] if radius is None else radius)
    return ufl.as_tensor([[G[0, 0], G[0, 1], 0], [G[1, 0], G[1, 1], 0], [0, 0, hoop]])


def in_section(points: MaterialPoints, F):
    """Components of a tensor in the plane of the grid, shape (..., gdim, gdim).

    Args:
        points: Material points.
        F: Tensor such as the deformation gradient: for UFL, or an array of shape
            (n, strain_dim, strain_dim).
    """
    if not points.axisymmetric:
        return F
    if isinstance(F, Expr):
        return ufl.as_tensor([[F[i, j] for j in range(2)] for i in range(2)])
    return np.ascontiguousarray(F[:, :2, :2])


def full_gradient(points: MaterialPoints, u: Array, H: Array) -> Array:
    """Gradients of an increment or a velocity at the points, with the hoop term if axisymmetric.

    Args:
        points: Material points.
        u: The increment (m), shape (n, d).
        H: Gradient of the increment on the grid, shape (n, d, d).

    Returns:
        Gradients, shape (n, strain_dim, strain_dim); H itself without a hoop term.
    """
    if not points.axisymmetric:
        return H
    G = np.zeros((len(u), 3, 3))
    G[:, :2, :2] = H
    G[:, 2, 2] = u[:, 0] / points["x"][:, 0]
    return G


def deformation(points: MaterialPoints, u: Array, H: Array) -> Array:
    """ΔF = I + ∇ũ of an increment; see `full_gradient`."""
    return full_gradient(points, u, H) + np.eye(points.strain_dim)
