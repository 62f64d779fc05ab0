"""Stable pairs of displacement and pressure, and a projection that stabilises other pairs.

If almost nothing drains, the pressure is a Lagrange multiplier that keeps volumes. The pair must
then satisfy the inf-sup condition (Brezzi & Fortin 1991). Functions of one degree satisfy it if the
displacement has cells of half the size ("nested" grids; Bercovier & Pironneau 1979, doi
10.1007/BF01399555). Equal degrees on the same cells do not satisfy it: pressures that alternate
from node to node do no work on volume changes. Splines of a higher degree on the same cells do not
satisfy it either. They are smoother than the pressure, unlike the elements of Taylor and Hood. For
quadratic splines with linear pressures, the constant falls with the size of the cells: 0.38, 0.27,
0.21 with 4, 8, 12 cells, none of them cut (`demos/studies/inf_sup.py`). The polynomial pressure
projection stabilises such pairs by a small compressibility, τ (q − q̄)(p − p̄) (Dohrmann & Bochev
2004, doi 10.1002/fld.752).

The projection also helps stable pairs. In a first step, storage acts like a mass matrix of the
pressure's functions. Its positive couplings make pressures overshoot next to a drained surface. The
projection lumps this mass matrix. In whole cells in one dimension, f = τ M must be 3 with linear
displacements, and 9/4 on nested grids. Splines for the displacement need more if the surface cuts
cells: the remainder of their last functions is stiff, with and without a ghost penalty. In a step
Δt, flow within a cell smooths pressures like the projection. The projection is therefore reduced by
the flow: τ = (f/M − 12 θ k Δt/(γ_w h²))₊. f is 3 for linear displacements and nested grids; 4.5
for quadratic splines with linear pressures, which then do not overshoot at all; 7 for quadratic
splines for both fields; 10 for displacements of cubic splines.
"""

from __future__ import annotations

from typing import Any

import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from dolfinmpm._platform.argumentchecks import choice, number
from dolfinmpm._platform.errors import UnstablePairWarning, warn
from dolfinmpm.basis.space import Space
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.forms.carriedfields import CellOffset
from dolfinmpm.grid.constants import own_constant
from dolfinmpm.grid.lattice import mean_size

__all__ = ["factor_of", "largest", "projected", "size_of"]

PROJECTIONS = ("auto", "none")
# f for displacements on the pressure's cells, by their degree. Each is the least f with which a
# first step overshoots by less than 1 %, wherever the surface cuts cells; a larger f delays the
# drainage next to the surface. Measured with 2 points per cell and direction, or 3 with quadratic
# splines for both fields.
_LUMPED = {1: 3.0, 2: 7.0, 3: 10.0}
_LUMPED_QUADRATIC_LINEAR = 4.5
# f for displacements on cells of half the size
_LUMPED_NESTED = 3.0


def size_of(p: Any) -> Any:
    """Mean size of the pressure's cells (m), a constant for UFL. Collective."""
    space: Space = p._dolfinmpm_space
    if space.refinement is not None:
        return own_constant(space.grid, space.finest_cell)
    size = space.cell_size
    if not isinstance(size, fem.Function):
        return size
    return own_constant(space.grid, mean_size(size))


def largest(K: Expr) -> Expr:
    """Upper bound of the largest eigenvalue of a permeability: the trace of a tensor."""
    return K if K.ufl_shape == () else ufl.tr(K)


def unstable(of_u: Space, of_p: Space) -> str | None:
    """Reason why a pair is not stable without a projection, or None if it is stable.

    Args:
        of_u, of_p: Spaces of the displacement and of the pressure.
    """
    u, p = of_u.basis.degree, of_p.basis.degree
    if u >= p and of_u.coarsen < of_p.coarsen:
        return None
    return (
        f"the displacement has functions of degree {u} with coarsen={of_u.coarsen}, and the "
        f"pressure has functions of degree {p} with coarsen={of_p.coarsen}"
    )


def _lumped(of_u: Space, of_p: Space) -> float:
    if of_u.coarsen < of_p.coarsen:
        return _LUMPED_NESTED
    if (of_u.basis.degree, of_p.basis.degree) == (2, 1):
        return _LUMPED_QUADRATIC_LINEAR
    return _LUMPED[of_u.basis.degree]


def factor_of(projection: Any, u: Any, p: Any) -> float:
    """Factor f of the projection, 0 for no projection.

    Args:
        projection: "auto", "none" or a number.
        u, p: Unknowns of the pair.

    Raises:
        ParameterError: `projection` is another string, or no number from 0.

    Warns:
        UnstablePairWarning: The pair needs a projection and has none; or the displacement has
            coarser cells than the pressure, and the projection does not help.
    """
    of_u, of_p = u._dolfinmpm_space, p._dolfinmpm_space
    if isinstance(projection, str):
        projection = choice("projection", projection, PROJECTIONS)
        factor = _lumped(of_u, of_p) if projection == "auto" else 0.0
    else:
        factor = number("projection", projection, 0.0, closed=True)
    why, comm = unstable(of_u, of_p), of_u.grid.comm
    if why is not None and of_u.coarsen > of_p.coarsen:
        warn(
            comm,
            f"{why}: pressures oscillate where little drains. The projection acts within single "
            "cells of the pressure and does not prevent this. Give the pressure cells of the same "
            f"size, coarsen={of_u.coarsen}, or of twice the size",
            UnstablePairWarning,
        )
    elif why is not None and factor == 0.0:
        warn(
            comm,
            f"{why}: without projection pressures oscillate where little drains. Leave "
            'projection="auto", or give the pressure coarser cells: '
            f"mpm.Space(grid, ..., shape=(), coarsen={2 * of_p.coarsen})",
            UnstablePairWarning,
        )
    return factor


def projected(
    points: MaterialPoints,
    factor: float,
    change: Expr,
    p: Any,
    q: Expr,
    M: Expr,
    K: Expr,
    theta: float,
) -> Expr:
    """The projection's term, τ (q − q̄)(p − p̄) for the change of the pressure in a step.

    τ = (f/M − 12 θ K Δt/h²)₊, see the text of this module.

    Args:
        points: Material points.
        factor: f, which is τ M for a step without drainage.
        change: Change of the pressure's gradient in the step (Pa/m), shape (gdim,).
        p: The pressure, an unknown of the problem (Pa).
        q: Test function of the pressure, or a multiple of it.
        M: P-wave modulus (Pa).
        K: Permeability over unit weight of the fluid (m²/(Pa s)).
        theta: Weight of the flow at the end of the step.
    """
    space: Space = p._dolfinmpm_space
    place, gdim = CellOffset(points, space), points.gdim
    offset, h = ufl.as_vector([place[i] for i in range(gdim)]), place[gdim]
    # in a cell, flow is the same term: the product of gradients, times h²/12
    flows = 12 * theta * largest(K) * points.dt / h**2
    slow = ufl.max_value(own_constant(points.grid, factor) / M - flows, 0.0)
    # second moments of a point's domain about the centre of mass of its cell's points
    own = sum(points.l[i] ** 2 * ufl.grad(q)[i] * change[i] for i in range(points.gdim)) / 3
    return slow * (ufl.dot(offset, ufl.grad(q)) * ufl.dot(offset, change) + own)
