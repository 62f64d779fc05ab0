"""The term of a weak form by which material points touch a rigid body."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from mpi4py import MPI
from ufl.core.expr import Expr

from dolfinmpm._platform.argumentchecks import (
    Tags,
    as_tags,
    check_kind,
    choice,
    refuse_idle,
    shown,
)
from dolfinmpm._platform.errors import FormError, ParameterError, raise_together
from dolfinmpm.assembly.term import Term, as_form
from dolfinmpm.body.boundary import Boundary
from dolfinmpm.body.formarguments import check_displacement, check_points
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.body.surface import Surface
from dolfinmpm.contact.activerigidcontact import ActiveRigidContact
from dolfinmpm.contact.contactlaw import ContactLaw
from dolfinmpm.contact.contactpoints import CornerFields
from dolfinmpm.contact.contactrates import largest_rate
from dolfinmpm.contact.corners import corner_count
from dolfinmpm.contact.displacementbasis import DisplacementBasis
from dolfinmpm.contact.heldcorners import HeldCorners, held_components
from dolfinmpm.contact.meanforces import MeanForceWeights, normal_energy, slip_energy
from dolfinmpm.contact.rigidbody import RigidBody
from dolfinmpm.cut.activation import Activation
from dolfinmpm.forms.declarations import Declaration

__all__ = ["RigidContact", "contact"]

Array = npt.NDArray[np.float64]


class RigidContact(Term):
    """Contact of material points with a rigid body in a weak form; see `contact`.

    Args:
        body, points, u: The body, the points, and the increment that moves the points.
        surface: Marked faces, or None.
        material: True if corners follow the points' material, False if they follow the domains.
        tags: Tags of the points that touch, or None for all points.
        law: The contact law.
        wet: Whether friction is that of the effective pressure.

    Attributes:
        body, points, u, surface, material, tags, law, wet: The arguments.
        names: Names of the points' fields with the state of the contact.
        dissipated: Work dissipated by friction (J), on all ranks.
        mean_weights: Weights of mean forces over a step in its balance; None for forces at the end.
        follows: Whether gaps are followed in time, see `followedgaps`; None in other steps.
        limit: Largest motion of the body at once (m).
        begun: Whether the overlap before the first step has been looked at.
    """

    def __init__(
        self, body: RigidBody, points: MaterialPoints, u: Any, surface: Surface | None,
        material: bool, tags: Tags, law: ContactLaw, wet: bool = False,
    ):  # fmt: skip
        self.body, self.points, self.u = body, points, u
        self.surface, self.material, self.tags = surface, material, tags
        self.law, self.wet, self._cell = law, wet, None
        first = f"contact{self._number()}"
        self.names = CornerFields(*(f"{first}_{name}" for name in CornerFields._fields))
        self.mean_weights: MeanForceWeights | None = None
        self.follows: bool | None = None
        self.dissipated, self.limit, self.begun = 0.0, math.inf, False

    def _number(self) -> int:
        """Number of the contact: the next one, or that of the same contact in an earlier form.

        So a problem of a new form goes on with the tangential forces of the problem before.
        """
        law, kept = self.law, self.points.__dict__
        counter = kept.setdefault("_contact_numbers", itertools.count(1))
        penalty = law.penalty, law.stiffness, law.slip_share
        own = self.body, self.surface, self.material, self.tags, penalty
        known = kept.setdefault("_rigid_contacts", {})
        if own not in known:
            known[own] = next(counter)
        return int(known[own])

    kind, definite = "contact", False

    @property
    def symmetric(self) -> bool:  # type: ignore[override]
        """See `Term`: slip makes the tangent unsymmetric."""
        return not self.law.friction

    @property
    def shares_surface(self) -> bool:
        """Whether corners share the rigid surface, for a limit of the shear stress."""
        return self.law.shear_limit is not None and self.surface is None

    @property
    def fusable(self) -> bool:  # type: ignore[override]
        """See `Term`: fused steps know no water."""
        return not self.wet

    @property
    def loads(self) -> list[Any]:
        """See `Term`: the loads on the free components of the body."""
        return self.body.loads

    def start_in_time(self, means: MeanForceWeights | None) -> None:
        """See `Term`.

        Raises:
            FormError: Explicit steps are given a bound of the penetration.
        """
        if means is None and self.law.penetration is not None:
            # without balance to find again, multipliers would add up from step to step
            raise FormError(
                f"{self!r} has penetration = {self.law.penetration:g} m, and explicit steps find "
                "no balance that could bound it: leave it out, and give a larger penalty="
            )

    def act(self, weights: MeanForceWeights | None, follows: bool | None) -> None:
        """See `Term`."""
        # in explicit steps light nodes would move corners of material, and not their points
        by_points = follows and weights is None and self.material and self.surface is None
        self.mean_weights, self.follows = weights, False if by_points else follows

    def __repr__(self) -> str:
        return f"the contact with '{self.body.name}'"

    def bind(self, declarations: Sequence[Declaration]) -> None:
        """Add the fields of the contact to the points; see `names`. Collective.

        Raises:
            ParameterError: The penalty needs Young's modulus, and a point has none.
        """
        points, names = self.points, self.names
        if self.wet and "pressure" not in points.fields:
            raise FormError(
                f"{self!r} has a pore_pressure, and the form has no water: take the form of "
                "mpm.poromechanics, or leave it out"
            )
        count = corner_count(points.gdim, self.surface)
        points.add_field(names.tangential_force, (count, points.gdim), "N")
        points.add_field(names.normal_force, (count,), "N")
        points.add_field(names.stiffness, (count,), "N/m")
        points.add_field(names.closing, (count,), "m")
        points.add_field(names.overlap, (count,), "m")
        points.add_field(names.gap, (count,), "m")
        if self.shares_surface:
            points.add_field(names.slip_area, (count,), "m^(d-1)")
        cell = self.u._dolfinmpm_space.finest_cell
        if self.law.stiffness is not None:
            self._refuse_far(declarations, cell)
            return
        points.add_field(names.modulus, (), "Pa")
        if self._cell is None:
            # a regridded grid must not change the stiffness of the contact
            self._cell = cell
        E = points[names.modulus]
        new = E == 0.0
        if points.comm.allreduce(bool(new.any()), op=MPI.LOR):
            E[new] = self._young(declarations)[new]
        error = None
        bad = ~(E > 0) & (True if self.tags is None else self.chosen())
        if bad.any():
            p = int(np.flatnonzero(bad)[0])
            error = ParameterError(
                f"{self!r} takes its penalty from Young's modulus, and no law of the form has one "
                f"at the point at {points['x'][p]} m: give contact(..., stiffness_per_area=...) in "
                "Pa/m"
            )
        raise_together(points.comm, error)

    def _young(self, declarations: Sequence[Declaration]) -> Array:
        """Young's moduli of the laws at this rank's points (Pa); 0 where a law has none."""
        found = np.zeros((len(self.points), 2))
        for declaration in declarations:
            found[declaration.rows] = declaration.elastic.moduli()
        lame = found[:, 0] - 2 * found[:, 1]
        whole = found[:, 0] - found[:, 1]
        with np.errstate(invalid="ignore", divide="ignore"):
            young = found[:, 1] * (2 * found[:, 1] + 3 * lame) / whole
        return np.where(whole > 0, young, 0.0)

    def _refuse_far(self, declarations: Sequence[Declaration], cell: float) -> None:
        """Raise ParameterError if κ is far from that of the softest point. Collective."""
        E = self._young(declarations)
        E = E[(E > 0.0) & (self.chosen() if self.tags is not None else True)]
        least = float(E.min(initial=np.inf))
        least = self.points.comm.allreduce(least, op=MPI.MIN)
        self.law.refuse_far(repr(self), least if np.isfinite(least) else 0.0, cell)

    def on(self, here: Activation) -> ActiveRigidContact:
        """See `Term`. Collective."""
        k = next(k for k, f in enumerate(here.fields) if f.space.increment is self.u)
        field, count = here.fields[k], len(self.points)
        displacement = DisplacementBasis.of(field, here.total, count, self.follows)
        active = ActiveRigidContact(self, displacement, k, mean_weights=self.mean_weights)
        nodes, d = active.corners.stencils.nodes, self.points.gdim
        held = held_components(
            self.points.grid, here.unknowns.fields[k].fixed[nodes],
            lambda: field.basis.node_coordinates()[nodes, :d],
        )  # fmt: skip
        active.held = HeldCorners.of(active, held, here.prescribed[k][nodes])
        return active

    def summary(self) -> str:
        """See `Term`."""
        return f"contact with '{self.body.name}', friction {self.law.friction:g}"

    def describe(self) -> str:
        """See `Term`."""
        law, water = self.law, ", of the effective pressure" if self.wet else ""
        limit = "" if law.shear_limit is None else f", shear_limit = {law.shear_limit:g}"
        kappa = f"penalty = {law.penalty:g}, stiffness_per_area = {law.stiffness}"
        return f"friction = {law.friction:g}{limit}{water}, {kappa}, tag = {self.tags}"

    def chosen(self, rows: Any = slice(None)) -> npt.NDArray[np.bool_]:
        """Which of the given points, or of all points, have the tags of the contact."""
        return np.isin(self.points["tag"][rows], self.tags or ())

    def rate(self, scaling: float) -> float:
        """See `Term`. Collective."""
        return largest_rate(self, scaling)

    def stored_here(self) -> float:
        """Energy stored by the penalties at this rank's points at the end of a step (J)."""
        if self.names.stiffness not in self.points.fields:
            return 0.0
        own = (self.names.normal_force, self.names.tangential_force, self.names.stiffness)
        normal, tangential, k = (self.points.fields.read(name) for name in own)
        on = k > 0.0
        stored = float(normal_energy(normal[on], k[on]).sum())
        if self.law.friction:
            stored += float(slip_energy(tangential[on], k[on], self.law.slip_share).sum())
        return stored

    def water_at(self, rows: npt.NDArray[np.integer], x: Array) -> Array:
        """Pressure of the pore water that does not rub, at the start of a step (Pa), shape (n,).

        Args:
            rows: Points of the corners, shape (n,).
            x: Positions of the corners (m), shape (n, gdim).
        """
        if not self.wet:
            return np.zeros(rows.size)
        points = self.points
        away = x - points["x"][rows]
        return points["pressure"][rows] + np.sum(points["pressure_gradient"][rows] * away, axis=1)

    def stiffness_at(self, rows: npt.NDArray[np.integer]) -> Array:
        """Penalty per area at some points (Pa/m), shape (len(rows),)."""
        law = self.law
        if law.stiffness is not None:
            return np.full(rows.size, law.stiffness)
        if self._cell is None:
            raise ParameterError(f"{self!r} has no stiffness before a problem is made of the form")
        return np.asarray(law.penalty / self._cell * self.points[self.names.modulus][rows])

    def stiffness_per_area(self) -> Array:
        """κ of the points on this rank (Pa/m), shape (points,)."""
        return self.stiffness_at(np.arange(len(self.points)))


def contact(
    body: RigidBody,
    points: MaterialPoints,
    u: Any,
    v: Any,
    *,
    friction: float = 0.0,
    shear_limit: float | None = None,
    penalty: float = 5.0,
    stiffness_per_area: float | None = None,
    slip_stiffness: float = 0.5,
    penetration: float | None = None,
    surface: Surface | Boundary | None = None,
    corners: str | None = None,
    pore_pressure: Any = None,
    tag: int | tuple[int, ...] | None = None,
) -> ufl.Form:
    """Contact with a rigid body, a term to add to the internal forces: F += contact(...).

    The corners of the points' domains touch the body, see `dolfinmpm.contact.corners`, or the
    faces of a `Surface` do. A corner with a gap g_N < 0 is inside the body. A pressure κ |g_N| per
    area pushes the corner out. Friction follows Coulomb's law: see
    `dolfinmpm.contact.contactlaw` for quasi-static and explicit steps, and
    `dolfinmpm.contact.meanforces` for implicit steps in time. Each corner has a share of the
    initial faces of its point.

    The penalty leaves some penetration. With the argument `penetration`, multipliers take over the
    pressure (Uzawa's augmented Lagrangian). Newton's method finds balance. The pressure then
    becomes the multiplier, and Newton's method finds balance again. This ends when the bound of
    the penetration holds. So the bound does not depend on the penalty.

    In axisymmetric problems the rigid body is a body of revolution, and moves along the axis
    only. Its meridian is the right half of the shape. Give the whole shape, symmetric about
    x[0] = 0, such as a `Wedge` for a cone.

    Args:
        body: The rigid body. The same body may be in several terms.
        points: Material points.
        u: Increment of the step, `Space.increment`.
        v: Test function, `Space.test`.
        friction: Coefficient μ of Coulomb's friction.
        shear_limit: Largest shear stress of friction (Pa), such as α c_u on clay, see
            `dolfinmpm.contact.sharedsurface`. It acts where μ times the pressure is larger, so it
            needs `friction`. None for no limit.
        penalty: κ in units of E/h: E is Young's modulus in the first state of the points, h the
            smallest height of a cell. About 100 for stiff confined bodies.
        stiffness_per_area: κ itself (Pa/m), instead of `penalty`; at least 0.05 E/h.
        slip_stiffness: Tangential stiffness during stick, as a share of κ.
        penetration: Largest penetration (m), or None for the penalty alone.
        surface: Faces that touch, instead of all corners: a `Surface`, or a `Boundary` that follows
            the body, for oblique or curved faces, which touch in place of the domains' stairs.
        corners: "domains" for corners of the points' domains, "material" for corners that turn
            and shear with the points' material, see `dolfinmpm.contact.corners`. The default is
            "material" for marked faces, and else "domains", for flowing soil.
        pore_pressure: Pore pressure of soil and water, the unknown p of `poromechanics`. Friction
            is then that of the effective pressure: the pressure of the contact less that of the
            water at the start of the step. Without it the water rubs, too.
        tag: Tag or tags of the points that can touch. None means all points of the field of u.

    Raises:
        ParameterError: An argument has the wrong type or a value outside its range.

    A plate presses a block by 1 cm:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    >>> V = mpm.Space(grid, "gimp")
    >>> F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, V.increment, V.test)
    >>> plate = mpm.RigidBody(mpm.Plane((0, 2), (0, -1)), increment=(0.0, -0.01), name="plate")
    >>> F += mpm.contact(plate, points, V.increment, V.test, penalty=100.0)
    >>> record = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom")).step()
    >>> plate.force[1].round(-2).item()
    23400.0
    """
    check_kind("body", body, RigidBody, "make it with mpm.RigidBody(shape)")
    check_points(points)
    check_displacement(points, u=u, v=v)
    if body.gdim != points.gdim:
        raise ParameterError(
            f"'{body.name}' is a body in {body.gdim}D, the points are in {points.gdim}D"
        )
    if points.axisymmetric:
        body.require_axis()
    law = ContactLaw(
        friction, penalty, stiffness_per_area, slip_stiffness, penetration, shear_limit
    )
    if surface is not None:
        surface = _surface_of(surface, points)
    if corners is None:
        corners = "domains" if surface is None else "material"
    corners = choice("corners", corners, ("domains", "material"))
    if surface is not None and surface.normal is None and corners == "domains":
        raise ParameterError(
            f"corners = 'domains' would do nothing: faces of '{surface.name}' follow the material, "
            "for they are not those of domains; leave it out"
        )
    tags = as_tags(tag)
    if tags is None:
        # corners of points outside the field of u would not move
        tags = getattr(getattr(u, "_dolfinmpm_space", None), "tags", None)
    wet = pore_pressure is not None
    if wet and not (isinstance(pore_pressure, Expr) and pore_pressure.ufl_shape == ()):
        raise ParameterError(
            f"pore_pressure = {shown(pore_pressure)} must be the pressure of the problem, the "
            "Space.increment of its space"
        )
    if not friction:
        refuse_idle("pore_pressure", pore_pressure, None, "it lessens friction: give friction=")
    term = RigidContact(body, points, u, surface, corners == "material", tags, law, wet)
    return as_form(term, u, v)


def _surface_of(given: Any, points: MaterialPoints) -> Surface:
    """The argument `surface` of `contact`; the same boundary has the same surface. Collective."""
    if not isinstance(given, Boundary):
        advice = "make it with mpm.Surface(points, where, normal), or give a Boundary"
        check_kind("surface", given, Surface, advice)
    if given.points is not points:
        raise ParameterError(f"the surface '{given.name}' is of other points")
    if isinstance(given, Surface):
        return given
    known = points.__dict__.setdefault("_surfaces_of_boundaries", {})
    if given not in known:
        known[given] = Surface.from_boundary(given)
    return known[given]
