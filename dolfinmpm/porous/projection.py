"""Which pairs of displacement and pressure are stable, and the projection that makes others so.

Where next to nothing drains the pressure is a multiplier that keeps volumes, and a pair must pass
the inf-sup condition (Brezzi & Fortin 1991): one order on a grid of half the size for the
displacement does ("nested" grids; Bercovier & Pironneau 1979, doi 10.1007/BF01399555). Equal orders
on one grid do not: pressures that alternate from node to node have no volumes to work on. Nor do
splines of a higher order, which are smoother than the pressure, where Taylor and Hood's pairs are
as smooth: of quadratic ones with linear pressures the constant falls with the size of the cells,
0.38, 0.27, 0.21 of 4, 8, 12 of them, before any is cut (`demos/studies/inf_sup.py`). The polynomial
pressure projection gives them some compressibility, τ (q − q̄)(p − p̄) (Dohrmann & Bochev 2004, doi
10.1002/fld.752).

It serves stable pairs too. A first step stores volume as a mass of the pressure's functions would,
whose positive couplings make pressures overshoot beside a drained surface; the projection lumps
that mass. In whole cells in one dimension that takes τ M = f of 3 with linear displacements and
9/4 on nested grids. Splines for the displacement take more, where the surface cuts cells: what is
left of their last functions is stiff, with a ghost penalty or without. In a step Δt, what flows in
a cell smooths as the projection does, and both together are given what the projection has alone
where nothing flows: τ = (f/M − 12 θ k Δt/(γ_w h²))₊, f being 3; 4.5 of quadratic splines with
linear pressures, with which they do not overshoot at all, 7 of quadratic splines for both, 10 of
cubic ones for the displacement.
"""

from __future__ import annotations

from typing import Any

import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from dolfinmpm._platform.checks import choice, number
from dolfinmpm._platform.errors import UnstablePairWarning, warn
from dolfinmpm.basis.space import Space
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.forms.carriedfields import CellOffset
from dolfinmpm.grid.constants import own_constant
from dolfinmpm.grid.lattice import mean_size

__all__ = ["factor_of", "largest", "projected", "size_of", "unstable"]

PROJECTIONS = ("auto", "none")
# f of displacements on the pressure's cells, by their degree: the least with which a first step
# overshoots by less than a percent wherever the surface cuts cells, as larger ones delay the
# drainage next to it; with 2 points per cell and direction, or 3 with quadratic splines for both
_LUMPED = {1: 3.0, 2: 7.0, 3: 10.0}
_LUMPED_QUADRATIC_LINEAR = 4.5
# and on cells of half the size
_LUMPED_NESTED = 3.0


def size_of(p: Any) -> Any:
    """Mean size of the pressure's cells, one number for UFL (m). Collective."""
    space: Space = p._dolfinmpm_space
    size = space.cell_size
    if not isinstance(size, fem.Function):
        return size
    return own_constant(space.grid, mean_size(size))


def largest(K: Expr) -> Expr:
    """A bound of what a permeability does to a vector."""
    return K if K.ufl_shape == () else ufl.tr(K)


def unstable(of_u: Space, of_p: Space) -> str | None:
    """Why a pair is not stable without a projection, or None if it is."""
    u, p = of_u.basis.degree, of_p.basis.degree
    if u >= p and of_u.coarsen < of_p.coarsen:
        return None
    return (
        f"the displacement has functions of degree {u} on cells of {of_u.coarsen} of the grid's a "
        f"direction, and the pressure of degree {p} on cells of {of_p.coarsen}"
    )


def _lumped(of_u: Space, of_p: Space) -> float:
    if of_u.coarsen < of_p.coarsen:
        return _LUMPED_NESTED
    if (of_u.basis.degree, of_p.basis.degree) == (2, 1):
        return _LUMPED_QUADRATIC_LINEAR
    return _LUMPED[of_u.basis.degree]


def factor_of(projection: Any, u: Any, p: Any) -> float:
    """Factor of the projection, 0 for none; warns where a pair needs what it lacks.

    Args:
        projection: "auto", "none" or a number.
        u, p: Increments of the pair.

    Raises:
        ParameterError: It is anything else.
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
            f"{why}: pressures oscillate where little drains, and the projection, which sees "
            "single cells of the pressure, does not prevent it. Give the pressure cells as coarse, "
            f"coarsen={of_u.coarsen}, or twice that",
            UnstablePairWarning,
        )
    elif why is not None and factor == 0.0:
        warn(
            comm,
            f"{why}: without projection pressures oscillate where little drains. Leave "
            'projection="auto", or take the pressure on coarser cells: '
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
    """The projection's term, τ (q − q̄)(p − p̄) of the change of the pressure in a step.

    τ = (f/M − 12 θ K Δt/h²)₊, see above.

    Args:
        points: Material points.
        factor: f, τ M of a step in which nothing drains.
        change: Change of the pressure's gradient (Pa/m).
        p: The pressure's increment.
        q: Its test function, or a multiple of it.
        M: P-wave modulus (Pa).
        K: Permeability by unit weight of the fluid (m²/(Pa s)).
        theta: Share of the flow at the end of the step.
    """
    space: Space = p._dolfinmpm_space
    place, gdim = CellOffset(points, space), points.gdim
    offset, h = ufl.as_vector([place[i] for i in range(gdim)]), place[gdim]
    # what flows is (h²/12) of the gradients' product in a cell too
    flows = 12 * theta * largest(K) * points.dt / h**2
    slow = ufl.max_value(own_constant(points.grid, factor) / M - flows, 0.0)
    # second moments of a point's domain about the centre of mass of its cell's points
    own = sum(points.l[i] ** 2 * ufl.grad(q)[i] * change[i] for i in range(points.gdim)) / 3
    return slow * (ufl.dot(offset, ufl.grad(q)) * ufl.dot(offset, change) + own)
