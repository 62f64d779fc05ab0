"""Essential conditions in the weak form, on boundaries that do not fit the grid.

The marker's traction by the law is t(u). The deviation from the prescribed displacement is
w(u) = gap + u − Δg. Nitsche's method (Nitsche 1971, doi 10.1007/BF02995904) adds

    − ∫ t(u)·v da ∓ ∫ t_e(v)·w(u) da + ∫ k w(u)·v da

to the internal forces. The first term is the reaction of the boundary. The second term makes the
form symmetric (−) or skew-symmetric (+). The third term is a penalty, no larger than stability
needs. The second term has the traction t_e of the law's elasticity, for two reasons. For a large
deviation w, second derivatives of the law could make the tangent indefinite. At the start of a
step, rounding decides whether a point at the yield surface has a plastic tangent. The symmetric
method needs a penalty k above the constant of ∫ |t_e(v)|² da ≤ k a(v, v).
`dolfinmpm.assembly.nitschepenalty` computes this constant from the cells with their stabilisation
against small cuts, and k is twice the constant. The penalty method has only the last term.

Of soil and water, t(u) is the traction of both: that of the effective stress less p n at the end of
the step. Without the pressure, the penalty would carry the water, with a gap p/k.

With F-bar, a(v, v) lacks the volume changes that differ between the points of a cell, and t_e has
them. Where such a body yields, nothing bounds the constant: k is then at least 50 M/h.

The gap is the deviation w at the end of the last step, so that deviations do not accumulate.
Explicit steps have forces from the gap and from the stress at the start of a step, see
`dolfinmpm.dynamics.boundaryforces`. Ghost penalties do not act in explicit steps. Nitsche's
constants are small there only with constraints between nodes (aggregation).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from ufl.algorithms.analysis import extract_constants
from ufl.core.expr import Expr

from dolfinmpm._platform.argumentchecks import (
    check_kind,
    choice,
    floats,
    number,
    refuse_idle,
    shown,
)
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm._platform.units import LARGEST_PENALTY
from dolfinmpm.body.axisymmetry import gradient, in_section
from dolfinmpm.body.boundary import Boundary
from dolfinmpm.body.formarguments import check_displacement
from dolfinmpm.body.formsigns import signed_form
from dolfinmpm.body.markergeometry import WITHIN, share_within, volumes_beside
from dolfinmpm.body.surfaceloads import area_at_end, own_grid, pressure_of
from dolfinmpm.forms.declarations import Declaration, subdomain
from dolfinmpm.grid.constants import begin_at_zero, first_step_share, mark_moving, own_constant
from dolfinmpm.kinematics.lawterms import flux
from dolfinmpm.kinematics.walldistance import in_front, look_ahead
from dolfinmpm.materials.base import Law
from dolfinmpm.materials.neohookean import NeoHookean

__all__ = ["METHODS", "TRACE", "WeakCondition", "dirichlet", "refuse_within"]

# Name of the markers' field of the constants of their cells (Pa/m), 0 if not known. The fields with
# _x, _cell, _body are places of marker, cell, nearest point then; _points the number of points.
TRACE = "trace_constant"

METHODS = ("nitsche", "skew", "penalty")
# Penalties in units of M/h where none is given: what a penalty alone leaves of the gap is a
# thousandth of a cell's extension; the skew method is stable with any.
_SKEW, _PENALTY = 1.0, {"penalty": 1e3}


@dataclass(frozen=True, eq=False)
class WeakCondition:
    """A weak Dirichlet condition and its fields at the markers.

    Attributes:
        boundary: The boundary.
        declaration: Declaration of the law at the markers; None for a penalty without a law.
        method: One of `METHODS`.
        penalty: Penalty in units of M/h; None for that of the method.
        fixed: Penalty (Pa/m), or None.
        stiffness: Name of the markers' field of the penalty k (Pa/m).
        moduli: Name of the markers' field of the law's elastic moduli M and G (Pa), or None.
        on: Name of the markers' field that is 1 if the body is in front of a marker, else 0. None
            for boundaries of a body, which always have the body in front.
        updates: Fields that a step sets, by name: gap, reached displacement and force.
        direction: Constrained components, the argument `direction` of `dirichlet`.
        wet: Whether the traction contains a pore pressure.
    """

    boundary: Boundary
    declaration: Declaration | None
    method: str
    penalty: float | None
    fixed: float | None
    stiffness: str
    moduli: str | None
    on: str | None
    updates: dict[str, Expr]
    direction: Any = None
    wet: bool = False
    pushes = False

    @property
    def local(self) -> bool:
        """Whether the penalty follows from the constants of the cells."""
        return self.fixed is None and self.penalty is None and self.method == "nitsche"

    @property
    def exact(self) -> bool:
        """Whether the terms contain gradients at the markers, which must fit the values."""
        return self.method != "penalty"

    def __repr__(self) -> str:
        return f"the condition at '{self.boundary.name}'"

    @property
    def forces(self) -> tuple[str, ...]:
        """Names of the markers' fields of forces on the body (N)."""
        return tuple(name for name in self.updates if name in self.boundary.forces)

    def stiffness_per_area(self) -> npt.NDArray[np.float64]:
        """The penalty at the markers of this rank (Pa/m), shape (markers,)."""
        return self.boundary.markers[self.stiffness]

    def stiffest(self) -> npt.NDArray[np.float64]:
        """Present penalty at the markers of this rank (Pa/m), 0 if no body is in front."""
        k = self.boundary.markers[self.stiffness]
        return k if self.on is None else k * self.boundary.markers[self.on]

    def prepare(self, rows: npt.NDArray[np.integer], sizes: npt.NDArray[np.float64]) -> None:
        """Set the law's moduli, and a penalty that is given or in units of M/h.

        Args:
            rows: Markers in active cells.
            sizes: Sizes h of the cells at the markers (m), shape (markers,).
        """
        markers = self.boundary.markers
        if self.moduli is not None:
            assert self.declaration is not None
            markers[self.moduli][self.declaration.rows] = self.declaration.elastic.moduli()
        if self.on is not None:
            on = in_front(self.boundary, rows, sizes)[0]
            markers[self.on] = on.astype(float)
            # where the body has left the boundary, no gap remains
            self.gaps()[~on] = 0.0
        if self.fixed is not None:
            markers[self.stiffness] = self.fixed
        elif not self.local:
            assert self.declaration is not None
            rows, factor = self.declaration.rows, _SKEW if self.penalty is None else self.penalty
            moduli = self.declaration.elastic.moduli()[:, 0]
            markers[self.stiffness][rows] = factor * moduli / sizes[rows]

    def own_work(self, fields: Any, moved: Any) -> float:
        """See `Wall.own_work`: a prescribed motion does all the work of its forces."""
        return 0.0

    def energy(self) -> tuple[float, float]:
        """See `Wall.energy`."""
        return 0.0, 0.0

    def gaps(self) -> npt.NDArray[np.float64]:
        """Deviation from the prescribed displacement at the markers of this rank (m)."""
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
    penalty: float | None = None,
    stiffness_per_area: float | None = None,
    pore_pressure: Any = None,
) -> ufl.Form:
    """Prescribed displacement on a boundary that does not fit the grid: terms to add to a form.

    Args:
        boundary: The boundary.
        u: Increment of the displacement in the step (m), `Space.increment`.
        v: Test function, `Space.test`.
        value: Displacement since the condition was made (m), shape (gdim,), or a number with a
            `direction`. It is a number or a vector; a DOLFINx constant; a UFL expression over the
            boundary; or a function of first positions (m), shape (gdim, n), that returns shape
            (n, gdim) or (n,). Substeps take a share of the change of a constant. The first step
            applies a value that is not zero at the start. In time the boundary moves evenly over
            each step.
        law: The law of the body at the boundary. Nitsche's method needs its traction. None with
            method="penalty" and a stiffness per area.
        method: "nitsche", "skew" or "penalty".
        direction: None prescribes all components. "normal" prescribes the component along the
            normal of the boundary at the start of the step, as rollers at any angle and planes of
            symmetry do. A vector prescribes the component along this vector.
        strain, tag: As for `momentum`. The condition acts where the nearest point has the tag.
        penalty: k in units of M/h: M is the P-wave modulus of the law's elasticity, h the size of
            the largest cell. The default of "nitsche" follows from an eigenproblem around each
            cell, and is at least 50 with F-bar. That of "skew" is 1. Both are at least 1000 in
            implicit steps with inertia. That of "penalty" is 1000. Explicit steps are short with
            it: give some 10 there. `mpm.stiffness_per_area` returns k.
        stiffness_per_area: k itself (Pa/m), instead of `penalty`.
        pore_pressure: Pore pressure of a body of soil and water, the unknown p of `poromechanics`
            (Pa, for UFL). The traction is then that of soil and water. A penalty alone needs none.

    Raises:
        ParameterError: An argument is not valid; `penalty` and `stiffness_per_area` are both
            given; the law is missing, also for a tag; or the body is on both sides of the boundary,
            and the method is not "penalty".
        FormError: A problem raises it if the body has a pore pressure and Nitsche's method has not.

    The left face lies within cells, and moves by one centimetre:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0.3, 0), (3.3, 2)), per_cell=2, density=2000.0)
    >>> V, law = mpm.Space(grid, "gimp"), mpm.materials.Hencky(1e6, 0.3)
    >>> F = mpm.momentum(law, points, V.increment, V.test)
    >>> left = mpm.Boundary.from_polygon(points, [(0.3, 2), (0.3, 0)], closed=False)
    >>> F += mpm.dirichlet(left, V.increment, V.test, (0.01, 0.0), law=law)
    >>> record = mpm.QuasiStatic(F, V.increment, points, stabilisation="ghost").step()
    >>> (points["x"] - points["x0"])[-1, 0].round(6).item()
    0.01
    """
    check_kind("boundary", boundary, Boundary, "make it with mpm.Boundary.from_polygon(...)")
    markers, d = boundary.markers, boundary.points.gdim
    check_displacement(boundary.points, u=u, v=v)
    method = choice("method", method, METHODS)
    penalty = _checked(penalty, stiffness_per_area, _PENALTY.get(method))
    declaration, traction = None, None
    if law is not None:
        P, declaration = flux(law, markers, u, strain, tag)
        traction = ufl.dot(P, boundary.normal)
        if pore_pressure is not None:
            traction -= _of_water(boundary, pore_pressure, u, method, strain)
    elif method != "penalty" or stiffness_per_area is None:
        raise ParameterError(
            'law = None goes only with method="penalty" and a stiffness_per_area (Pa/m); give the '
            "law of the body at the boundary"
        )
    else:
        refuse_idle("tag", tag, None, "it is the tag of the law: give law=, too, or leave tag out")
    if method != "penalty":
        tagged = boundary.points.comm.allgather(np.unique(boundary.points["tag"]))
        # the problem knows which of several tags move with u
        if len(np.unique(np.concatenate(tagged))) == 1:
            refuse_within(boundary, method)
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
        boundary, declaration, method, penalty, stiffness_per_area, k.name, moduli, on,
        {gap.name: along, reached.name: wanted, total.name: force * markers.V}, direction,
        pore_pressure is not None,
    )  # fmt: skip
    if condition.local:
        markers.add_field(TRACE, (), "Pa/m")
        markers.add_field(f"{TRACE}_points", ())
        for name in ("x", "cell", "body"):
            markers.add_field(f"{TRACE}_{name}", (d,), "m")
    return condition_form(condition, term, "the condition (mpm.dirichlet)")


def refuse_within(boundary: Boundary, method: str, tags: Sequence[int] | None = None) -> None:
    """Raise ParameterError for a boundary through a body: it has two sides, with two tractions.

    Args:
        boundary: The boundary.
        method: "nitsche" or "skew".
        tags: Tags of the points that move with the condition's field, or None for all points.
    """
    points, markers = boundary.points, boundary.markers
    share = share_within(*volumes_beside(points, markers["x"], markers["area"], tags))
    if share > WITHIN:
        raise ParameterError(
            f"{100 * share:.0f} % of the boundary '{boundary.name}' run through the body, with "
            f'material points on both sides, and method="{method}" takes the traction of one side: '
            'give method="penalty", whose force is that of both sides; or leave a slot in the body '
            "that is wider than a cell, with a boundary along each side"
        )


def _of_water(boundary: Boundary, p: Any, u: Expr, method: str, strain: str) -> Expr:
    """Pressure of the water on the boundary at the end of the step, per area at its start (Pa)."""
    if method == "penalty" or not isinstance(p, Expr):
        raise ParameterError(
            f"pore_pressure = {shown(p)} must be the pressure of the problem, Space.increment of "
            'its space, and goes with method="nitsche" or "skew": a penalty alone needs no pressure'
        )
    p = pressure_of(boundary.points, p)
    n = boundary.normal
    return p * (n if strain == "small" else area_at_end(boundary.markers, n, u))


def condition_form(condition: Any, term: Expr, what: str) -> ufl.Form:
    """The term of a condition at its boundary, with the condition in its metadata.

    Args:
        condition: The condition, a `WeakCondition` or a `Wall`.
        term: The integrand.
        what: Its name in messages.
    """
    boundary, declaration = condition.boundary, condition.declaration
    mark = {**boundary.ds.metadata(), "condition": condition}
    tags = None if declaration is None else declaration.tags
    ds = boundary.ds(subdomain(tags), metadata=mark)
    return signed_form(term, ds, f"{what} at '{boundary.name}'")


def _checked(penalty: Any, stiffness_per_area: Any, usual: float | None) -> float | None:
    """The penalty in units of M/h, or None where it follows from something else."""
    if stiffness_per_area is None:
        return usual if penalty is None else number("penalty", penalty, 0.0, LARGEST_PENALTY)
    if penalty is not None:
        raise ParameterError("penalty and stiffness_per_area are both given; give one of them")
    number("stiffness_per_area", stiffness_per_area, 0.0, unit="Pa/m")
    return None


def _axis(boundary: Boundary, direction: Any) -> Expr:
    """Unit vector of a direction, for UFL."""
    if isinstance(direction, str):
        choice("direction", direction, ("normal",))
        return boundary.normal
    d = boundary.points.gdim
    given = floats(direction)
    size = 0.0 if given is None or given.shape != (d,) else float(np.linalg.norm(given))
    if given is None or not 0 < size < np.inf:
        raise ParameterError(
            f'direction = {shown(direction)} must be None, "normal" or a vector of {d} components'
        )
    return own_constant(boundary.points.grid, given / size)


def _projection(boundary: Boundary, direction: Any) -> Callable[[Expr], Expr]:
    n = None if direction is None else _axis(boundary, direction)
    return lambda w: w if n is None else ufl.dot(w, n) * n


def _value(boundary: Boundary, value: Any, shape: tuple[int, ...], name: str) -> Expr:
    """The prescribed displacement, for UFL."""
    what = "a number along the direction" if shape == () else f"a vector of shape {shape}"
    if isinstance(value, Expr):
        if value.ufl_shape != shape:
            raise ParameterError(
                f"value '{str(value)[:100]}' has the shape {value.ufl_shape} and must be {what}"
            )
        own_grid(boundary.points, "value", value)
        if isinstance(value, fem.Constant):
            begin_at_zero("value", value)
        else:
            for constant in extract_constants(value):
                mark_moving(constant)
        return value
    share = first_step_share(boundary.points.grid)
    if callable(value):
        return share * boundary.markers.add_field(name, shape, "m", value)
    given = None if isinstance(value, str) else floats(value)
    if given is not None and given.shape == () and given == 0:
        given = np.zeros(shape)
    if given is None or given.shape != shape or not np.isfinite(given).all():
        raise ParameterError(f"value = {shown(value)} must be {what} (m), finite")
    prescribed = own_constant(boundary.points.grid, given)
    return share * prescribed if np.any(given) else prescribed
