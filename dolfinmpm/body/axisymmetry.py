"""Bodies of revolution: points go around the axis x[0] = 0, and gradients have a hoop term.

The coordinates are the radius r = x[0] and the height z = x[1]. A displacement (u_r, u_z) that is
the same all around strains a ring by u_r/r around itself, so that its gradient is the tensor

    ∇u = [[∂_r u_r, ∂_z u_r, 0], [∂_r u_z, ∂_z u_z, 0], [0, 0, u_r/r]]

in the axes r, z, θ. With that in the place of the plane gradient all kinematics hold as they are in
three dimensions; r is that of the point at the start of the step, as gradients are by positions
then. So the hoop component of F, a product of 1 + u_r/r over the steps, is the ratio of the
present radius of the ring to its first one. Functions that are averaged over domains are averaged
around the axis: u_r/r has the mean of u_r over the section of the domain by its centre's radius,
and slopes along the radius are weighted with it (`dolfinmpm.basis.latticebasis.ring_slopes`).

Amounts are those all around, 2π r times those of the section: volumes (m³), masses (kg), areas
of faces (m²), forces (N), and energies (J).
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

# What rounding may leave of a grid beyond the axis, by its size
_SLACK = 1e-12


def require_axis(grid: Mesh) -> None:
    """Raise unless a grid can hold a body of revolution about x[0] = 0. Collective.

    Raises:
        UnsupportedGridError: It is not two-dimensional, or reaches to negative radii.
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
    """Amount of a whole ring, 2π r times that of its section; exact at the section's centroid."""
    return 2 * math.pi * radius * amount


def section(points: PointTable, volume: str, x: str) -> Array:
    """What the points have of the grid: areas of axisymmetric sections (m²), else volumes (m^d).

    Args:
        points: Material points.
        volume: Name of the field of volumes.
        x: Name of the field of positions that goes with it.
    """
    V = points[volume]
    return V / ring(points[x][:, 0], 1.0) if points.axisymmetric else V


def gradient(points: MaterialPoints, w, *, radius: Expr | None = None) -> Expr:
    """Gradient of a displacement or a test function at the points, in UFL.

    Of shape (d, d), `ufl.grad(w)`; at axisymmetric points (3, 3), in the axes r, z, θ and with
    the hoop term w_r/r. What is written with it in the place of `ufl.grad` holds for both. That of
    a scalar is `ufl.grad(w)`, of shape (d,), at axisymmetric points too: it is the same all around.

    Args:
        points: Material points.
        w: Increment or test function of a displacement, or of a scalar field.
        radius: r in terms that are not sums over the points; that of the points by default.

    Raises:
        ParameterError: These are no points, or w is no field of UFL, or at axisymmetric points of
        another shape.

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
    """The part of a tensor of the points within the dimensions of the grid.

    Args:
        points: Material points.
        F: The tensor, such as their deformation gradient: in UFL, or an array of shape
            (n, strain_dim, strain_dim).
    """
    if not points.axisymmetric:
        return F
    if isinstance(F, Expr):
        return ufl.as_tensor([[F[i, j] for j in range(2)] for i in range(2)])
    return np.ascontiguousarray(F[:, :2, :2])


def full_gradient(points: MaterialPoints, u: Array, H: Array) -> Array:
    """∇ũ of an increment, or a velocity, at the points, with the hoop term of axisymmetric points.

    Args:
        points: Material points.
        u: The increment (m), shape (n, d).
        H: Its gradient on the grid, shape (n, d, d).

    Returns:
        Shape (n, strain_dim, strain_dim); H itself where there is no hoop term.
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
