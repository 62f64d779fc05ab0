"""Essential conditions imposed in the weak form, on boundaries that do not fit the grid.

With the traction t(u) of the law at a marker, and what is missing of the prescribed
displacement, w(u) = gap + u − Δg, Nitsche's method (Nitsche 1971, doi 10.1007/BF02995904) adds

    − ∫ t(u)·v da ∓ ∫ t_e(v)·w(u) da + ∫ k w(u)·v da

to the internal forces: the reaction of the boundary, what makes the whole symmetric (−) or skew
(+), and a penalty that is no more than stability needs. In the second term the traction is that of
the law's elasticity: where much of the displacement is still missing, second derivatives of the
law would make the tangent of the whole indefinite, and whether a point at the yield surface has
a plastic tangent at the start of a step is a matter of rounding. For the symmetric one k must
exceed the constant of ∫ |t_e(v)|² da ≤ k a(v, v), which `dolfinmpm.assembly.nitschepenalty`
computes from the cells with their stabilisation against small cuts; twice that is taken. The
penalty method keeps the last term alone.

The gap is what former steps have left of w, so that nothing accumulates. Explicit steps have the
forces of the gap and of the stress at their start, see `dolfinmpm.dynamics.boundaryforces`; there
ghost penalties do not act, and Nitsche's constants are small where nodes are tied alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from dolfinmpm._platform.checks import check_kind, choice, number, shown
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.body.acting import acting
from dolfinmpm.body.axisymmetry import gradient, in_section
from dolfinmpm.body.boundary import Boundary
from dolfinmpm.body.formarguments import check_displacement
from dolfinmpm.forms.declarations import Declaration
from dolfinmpm.grid.constants import own_constant
from dolfinmpm.grid.lattice import largest_cell
from dolfinmpm.kinematics.coverage import in_front, look_ahead
from dolfinmpm.kinematics.lawterms import flux
from dolfinmpm.materials.base import Law
from dolfinmpm.materials.neohookean import NeoHookean

__all__ = ["METHODS", "TRACE", "WeakCondition", "dirichlet"]

# Name of the markers' field of their cells' constants (Pa/m), 0 where not known; and with _x and
# _cell behind it where the marker and its cell were then
TRACE = "trace_constant"

METHODS = ("nitsche", "skew", "penalty")
# Penalties in units of M/h where none is given: what a penalty alone leaves of the gap is a
# thousandth of a cell's extension; the skew method is stable with any.
_BETA = {"skew": 1.0, "penalty": 1e3}


@dataclass(frozen=True, eq=False)
class WeakCondition:
    """What a weak condition keeps at its markers.

    Attributes:
        boundary: The boundary.
        declaration: The law at the markers; None for a penalty of given stiffness.
        method: One of `METHODS`.
        beta: Penalty in units of M/h; None for twice the constant of the cells.
        fixed: Penalty (Pa/m), or None.
        stiffness: Name of the markers' field of the penalty k (Pa/m).
        moduli: Name of that of the law's elastic moduli M and G (Pa), or None.
        on: Name of that of whether the body is in front of a marker; None for boundaries of
            a body, where it always is.
        updates: The gap and the displacement reached, by name, as a step leaves them.
        direction: The components that it holds, as `dirichlet` is given them.
    """

    boundary: Boundary
    declaration: Declaration | None
    method: str
    beta: float | None
    fixed: float | None
    stiffness: str
    moduli: str | None
    on: str | None
    updates: dict[str, Expr]
    direction: Any = None

    @property
    def local(self) -> bool:
        """Whether the penalty follows from the constants of the cells."""
        return self.fixed is None and self.beta is None

    @property
    def exact(self) -> bool:
        """Whether it has gradients at the markers beside values, which must fit them."""
        return self.method != "penalty"

    def stiffest(self) -> npt.NDArray[np.float64]:
        """The penalty at the markers of this rank as it is now, 0 where it is off (Pa/m)."""
        k = self.boundary.markers[self.stiffness]
        return k if self.on is None else k * self.boundary.markers[self.on]

    def prepare(self, rows: npt.NDArray[np.integer]) -> None:
        """Set the penalty where it is in units of M/h, or given, and the law's moduli.

        Args:
            rows: Markers in active cells.
        """
        markers = self.boundary.markers
        if self.moduli is not None:
            assert self.declaration is not None
            markers[self.moduli][self.declaration.rows] = self.declaration.moduli()
        if self.on is not None:
            on = in_front(self.boundary, rows)[0]
            markers[self.on] = on.astype(float)
            # where the body has gone it leaves nothing behind
            self.gaps()[~on] = 0.0
        if self.fixed is not None:
            markers[self.stiffness] = self.fixed
        elif self.beta is not None:
            assert self.declaration is not None
            rows = self.declaration.rows
            moduli = self.declaration.moduli()[:, 0]
            markers[self.stiffness][rows] = self.beta * moduli / largest_cell(markers.grid)

    def gaps(self) -> npt.NDArray[np.float64]:
        """What is missing of the prescribed displacement at the markers of this rank (m)."""
        return self.boundary.markers[next(iter(self.updates))]


def dirichlet(
    boundary: Boundary,
    u: fem.Function,
    v: Any,
    value: Any = 0.0,
    *,
    law: Law | NeoHookean | None = None,
    method: str = "nitsche",
    direction: Any = None,
    strain: str = "large",
    tag: int | tuple[int, ...] | None = None,
    beta: float | None = None,
    stiffness: float | None = None,
) -> ufl.Form:
    """Prescribed displacement on a boundary that does not fit the grid, to be added.

    Args:
        boundary: The boundary.
        u: Increment of the step, `Space.increment`.
        v: Test function, `Space.test`.
        value: Displacement since the first step (m): a vector, or with a direction a number
            along it; a DOLFINx constant, which steps scale in parts, a UFL expression over the
            boundary, or a function of first positions (m), shape (gdim, n), to (n, gdim) or (n,).
        law: The law of the body there, whose traction Nitsche's method needs. None with
            method="penalty" and a stiffness.
        method: "nitsche", "skew" or "penalty".
        direction: None for all components, "normal" for the one along the boundary's
            normal at the start of the step, as of rollers at any angle and symmetry planes, or
            a vector for the one along it.
        strain, tag: As for `momentum`; the condition is at markers whose nearest point
            has the tag.
        beta: Penalty in units of M/h, the P-wave modulus of the law's elasticity over the size of
            a cell; by default that of the cells' own constants for "nitsche", 1 for "skew" and
            1000 for "penalty", of which explicit steps are short: give some 10 there.
        stiffness: Penalty k (Pa/m), instead.

    Raises:
        ParameterError: An argument is not what it may be.
    """
    check_kind("boundary", boundary, Boundary, "make it with mpm.Boundary.from_polygon(...)")
    markers, d = boundary.markers, boundary.points.gdim
    check_displacement(boundary.points, u=u, v=v)
    method = choice("method", method, METHODS)
    if beta is not None and stiffness is not None:
        raise ParameterError("beta and stiffness are both given; give one of them")
    if beta is not None:
        number("beta", beta, 0.0)
    if stiffness is not None:
        number("stiffness", stiffness, 0.0, unit="Pa/m")
    declaration, traction = None, None
    if law is not None:
        P, declaration = flux(law, markers, u, strain, tag)
        traction = ufl.dot(P, boundary.normal)
    elif method != "penalty" or stiffness is None:
        raise ParameterError(
            'law = None is of method="penalty" with a stiffness (Pa/m) alone; give the law of the '
            "body at the boundary"
        )
    beta = _BETA.get(method) if beta is None and stiffness is None else beta
    onto = _projection(boundary, direction)
    shape = (d,) if direction is None else ()
    name = f"dirichlet{len(boundary.forces) + 1}"
    gap = markers.add_field(f"{name}_gap", (d,), "m")
    reached = markers.add_field(f"{name}_reached", (d,), "m")
    k = markers.add_field(f"{name}_stiffness", (), "Pa/m")
    g = _value(boundary, value, shape, f"{name}_value")
    wanted = g if direction is None else g * _axis(boundary, direction)
    missing = gap + u - (wanted - reached)
    along = onto(missing)
    term, moduli = k * ufl.dot(along, v), None
    force, on = -k * along, None
    if declaration is not None and traction is not None and method != "penalty":
        sign = -1.0 if method == "nitsche" else 1.0
        M = markers.add_field(moduli := f"{name}_moduli", (2,), "Pa")
        strain_of_v, n = ufl.sym(gradient(markers, v)), boundary.normal
        change = (M[0] - 2 * M[1]) * ufl.tr(strain_of_v) * n
        change += 2 * M[1] * ufl.dot(in_section(markers, strain_of_v), n)
        force += onto(traction)
        term += -ufl.dot(onto(traction), v) + sign * ufl.dot(change, along)
    if not boundary.activates:
        look_ahead(boundary)
        mask = markers.add_field(on := f"{name}_on")
        term, force, along = mask * term, mask * force, mask * along
    total = markers.add_field(f"{name}_force", (d,), "N")
    boundary.forces.append(total.name)
    condition = WeakCondition(
        boundary, declaration, method, beta, stiffness, k.name, moduli, on,
        {gap.name: along, reached.name: wanted, total.name: force * markers.V}, direction,
    )  # fmt: skip
    if condition.local:
        markers.add_field(TRACE, (), "Pa/m")
        for name in (f"{TRACE}_x", f"{TRACE}_cell"):
            markers.add_field(name, (d,), "m")
    mark = {**boundary.ds.metadata(), "condition": condition}
    where: Any = "everywhere"
    if declaration is not None and declaration.tags is not None:
        where = declaration.tags if len(declaration.tags) > 1 else declaration.tags[0]
    ds = boundary.ds(where, metadata=mark)
    return acting(term, ds, f"the condition (mpm.dirichlet) at '{boundary.name}'")


def _axis(boundary: Boundary, direction: Any) -> Expr:
    """The unit vector of a direction."""
    if isinstance(direction, str):
        choice("direction", direction, ("normal",))
        return boundary.normal
    d = boundary.points.gdim
    try:
        given = np.asarray(direction, float)
    except (TypeError, ValueError):
        given = np.empty(0)
    size = float(np.linalg.norm(given)) if given.shape == (d,) else 0.0
    if not (np.isfinite(size) and size > 0):
        raise ParameterError(
            f'direction = {shown(direction)} must be None, "normal" or a vector of {d} components'
        )
    return own_constant(boundary.points.grid, given / size)


def _projection(boundary: Boundary, direction: Any) -> Callable[[Expr], Expr]:
    if direction is None:
        return lambda w: w
    n = _axis(boundary, direction)
    return lambda w: ufl.dot(w, n) * n


def _value(boundary: Boundary, value: Any, shape: tuple[int, ...], name: str) -> Expr:
    """What is prescribed, for UFL."""
    what = "a number along the direction" if shape == () else f"a vector of shape {shape}"
    if isinstance(value, Expr):
        if value.ufl_shape != shape:
            raise ParameterError(
                f"value '{str(value)[:100]}' has the shape {value.ufl_shape} and must be {what}"
            )
        return value
    if callable(value):
        return boundary.markers.add_field(name, shape, "m", value)
    try:
        given = np.full(99, np.nan) if isinstance(value, str) else np.asarray(value, float)
    except (TypeError, ValueError):
        given = np.full(99, np.nan)
    if given.shape == () and given == 0:
        given = np.zeros(shape)
    if given.shape != shape or not np.isfinite(given).all():
        raise ParameterError(f"value = {shown(value)} must be {what} (m), finite")
    return own_constant(boundary.points.grid, given)
