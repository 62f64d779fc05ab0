"""The term of a weak form for contact of two deformable bodies, each with its own field."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy
import ufl
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import shown
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.assembly.term import Term, as_form
from dolfinmpm.body.boundary import Boundary
from dolfinmpm.body.formarguments import check_displacement
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.contact.activetwobodycontact import ActiveTwoBodyContact
from dolfinmpm.contact.contactlaw import ContactLaw
from dolfinmpm.contact.contactpairs import LAYERS, ContactPairs
from dolfinmpm.contact.contactpoints import MarkerFields
from dolfinmpm.contact.meanforces import MeanForceWeights
from dolfinmpm.cut.activation import Activation, ActiveDomain, Coupling
from dolfinmpm.forms.declarations import Declaration
from dolfinmpm.grid.lattice import require_lattice, smallest_height

__all__ = ["TwoBodyContact", "contact_between"]


class TwoBodyContact(Term):
    """Contact of two boundaries in a weak form; see `contact_between`.

    Args:
        boundaries: The first boundary, with the markers that touch, and the second boundary.
        u: Increments that move the bodies.
        law: The contact law.

    Attributes:
        boundaries, u, law: The arguments.
        stiffness: κ (Pa/m). If κ follows from moduli, it is valid only after `bind`.
        mean_weights: Weights of mean forces over a step in its balance; None for forces at its end.
        name: Name in records, and first part of the names of the markers' fields.
        names: Names of the fields of the first boundary's markers with the state of the contact.
    """

    def __init__(self, boundaries: tuple[Boundary, Boundary], u: tuple[Any, Any], law: ContactLaw):
        self.boundaries, self.u, self.law = boundaries, u, law
        # slip makes the tangent unsymmetric
        self.symmetric = not law.friction
        self.stiffness: float = 0.0 if law.stiffness is None else law.stiffness
        counter = self.points.__dict__.setdefault("_contact_numbers", itertools.count(1))
        self.name = f"contact{next(counter)}"
        self.mean_weights: MeanForceWeights | None = None
        self.names = MarkerFields(*(f"{self.name}_{part}" for part in MarkerFields._fields))

    kind, layers = "contact", LAYERS

    @property
    def sides(self) -> Sequence[tuple[Boundary, Any]]:
        """See `Term`."""
        return list(zip(self.boundaries, self.u))

    def act(self, weights: MeanForceWeights | None, follows: bool | None) -> None:
        """See `Term`."""
        self.mean_weights = weights

    def couple(self, here: ActiveDomain) -> list[Coupling]:
        """See `Term`. Collective."""
        return [ContactPairs(self, here)]

    def on(self, here: Activation) -> ActiveTwoBodyContact | None:
        """See `Term`."""
        own = (c for c in here.couplings if isinstance(c, ContactPairs) and c.contact is self)
        pairs = next(own, None)
        return None if pairs is None else ActiveTwoBodyContact(pairs, self.mean_weights)

    def energy(self) -> tuple[float, float]:
        """See `Term`. Collective."""
        return self.stored, self.dissipated

    def summary(self) -> str:
        """See `Term`."""
        return f"contact of two bodies, friction {self.law.friction:g}"

    def __repr__(self) -> str:
        return f"the contact of {self.boundaries[0]} with {self.boundaries[1]}"

    @property
    def points(self) -> MaterialPoints:  # type: ignore[override]
        """The points of both bodies."""
        return self.boundaries[0].points

    @property
    def dissipated(self) -> float:
        """Work dissipated by friction (J), on all ranks. Collective."""
        done = float(self.boundaries[0].markers[self.names.work].sum())
        return self.points.comm.allreduce(done, op=MPI.SUM)

    @property
    def stored(self) -> float:
        """Energy stored by the penalties (J), on all ranks. Collective."""
        own = float(self.boundaries[0].markers[self.names.stored].sum())
        return self.points.comm.allreduce(own, op=MPI.SUM)

    @property
    def begun(self) -> bool:
        """Whether at least one step has been taken. Collective."""
        steps = self.boundaries[0].markers[self.names.steps]
        return self.points.comm.allreduce(bool(steps.any()), op=MPI.LOR)

    def stiffness_per_area(self) -> npt.NDArray[np.float64]:
        """κ (Pa/m), shape ()."""
        return np.asarray(self.stiffness)

    def check_sides(self) -> None:
        """Raise unless each boundary has its body behind it. Collective.

        Raises:
            ParameterError: The points with the tags of a field are in front of its boundary.
        """
        points = self.points
        for boundary, u in zip(self.boundaries, self.u):
            x, area = boundary.markers["x"], boundary.markers["area"]
            own = points["x"][np.isin(points["tag"], u._dolfinmpm_space.tags)]
            votes = np.zeros(2, int)
            if len(own) and len(x):
                nearest = own[scipy.spatial.cKDTree(own).query(x)[1]]
                behind = np.einsum("pi,pi->p", x - nearest, area) > 0.0
                votes[:] = np.count_nonzero(behind), np.count_nonzero(~behind)
            behind, before = points.comm.allreduce(votes, op=MPI.SUM)
            if before > behind:
                raise ParameterError(
                    f"the points of the tags {u._dolfinmpm_space.tags}, which the field beside "
                    f"{boundary} moves, are in front of {before} of {behind + before} of its "
                    "markers: give u and v in the order of the boundaries, and polygons with "
                    "the body on their left"
                )

    def bind(self, declarations: Sequence[Declaration]) -> None:
        """Add the fields of the contact to the markers, and find the penalty. Collective.

        Raises:
            ParameterError: The penalty needs Young's modulus, and a body has none.
        """
        markers, points = self.boundaries[0].markers, self.points
        units = "N", "N", "J", "", "J", "J", "N"
        for name, unit in zip(self.names, units):
            vector = name in (self.names.tangential_force, self.names.force)
            markers.add_field(name, (points.gdim,) if vector else (), unit)
        first, second = self.boundaries
        if self.names.force not in first.forces:
            first.forces.append(self.names.force)
            second.against.append((markers, self.names.force))
        cell, moduli = smallest_height(points.grid), []
        for k, u in enumerate(self.u):
            own = [d for d in declarations if d.u is u]
            found = max(
                (float(_young(d.elastic.moduli()).max(initial=0.0)) for d in own), default=0.0
            )
            moduli.append(points.comm.allreduce(found, op=MPI.MAX))
            if self.law.stiffness is None and not moduli[k] > 0.0:
                raise ParameterError(
                    f"{self!r} takes its penalty from Young's moduli, and no law of the form has "
                    f"one for the body of {self.boundaries[k]}: give "
                    "contact_between(..., stiffness_per_area=...) in Pa/m"
                )
        both = 2.0 * moduli[0] * moduli[1] / (sum(moduli) or 1.0)
        if self.law.stiffness is not None:
            self.law.refuse_far(repr(self), both, cell)
            return
        self.stiffness = self.law.penalty * both / cell


def _young(moduli):
    """Young's moduli (Pa) from those of P-waves and shear, shape (n, 2)."""
    M, G = moduli[:, 0], moduli[:, 1]
    with np.errstate(invalid="ignore", divide="ignore"):
        E = G * (3 * M - 4 * G) / (M - G)
    return np.where(M > G, E, 0.0)


def contact_between(
    boundaries: Sequence[Boundary],
    u: Sequence[Any],
    v: Sequence[Any],
    *,
    friction: float = 0.0,
    shear_limit: float | None = None,
    penalty: float = 5.0,
    stiffness_per_area: float | None = None,
    slip_stiffness: float = 0.5,
    penetration: float | None = None,
) -> ufl.Form:
    """Contact of two deformable bodies, a term to add: F += contact_between(...).

    Each body has its own field, a `Space` with its tags, and a `Boundary` that follows the body.
    The markers of the first boundary are the quadrature points of contact.

    At the start of a step each marker finds the facing piece of the other boundary. It searches
    along the mean of both normals. For surfaces that lie on each other, this is exact to third
    order in the distance of markers. Gap, normal and place are fixed at the start of the step. The
    increment of the gap is the difference of both fields at the two facing places. So the forces
    on both bodies are equal and opposite along one line. Their accuracy in each body is that of
    the integration of its functions.

    A polygon with one Gauss point per piece, `Boundary.from_polygon(..., rule=1, spacing=h/4)`, is
    cut anew at the grid's lines in every step. Then a uniform pressure balances a uniform stress.

    Where the gap is closed, a pressure κ |g| per area pushes the bodies apart. Friction follows
    Coulomb's law, see `dolfinmpm.contact.contactlaw`; in time in the mean over a step, see
    `dolfinmpm.contact.meanforces`. A bound of the penetration adds multipliers,
    see `contact`.

    `Boundary.force()` is the force on the body of each boundary.

    In a step the bodies may approach by at most one cell. A step with a larger approach is halved.
    The first surface should be the smaller, the finer, or that of the softer body. A boundary may
    reach into cells without points. These cells are active, so stabilise both fields.

    Args:
        boundaries: The first boundary, with the markers that touch, and the second boundary.
        u: Increments of the two fields, `Space.increment`, in the order of the boundaries.
        v: Test functions of the two fields, `Space.test`, in the same order.
        friction: Coefficient μ of Coulomb's friction.
        shear_limit: Largest shear stress of friction (Pa), such as α c_u on clay. It acts where
            μ times the pressure is larger, so it needs `friction`. None for no limit.
        penalty: κ in units of E/h: E is the harmonic mean of the bodies' Young's moduli, h the
            smallest height of a cell. `mpm.stiffness_per_area` returns κ. Where leaves are smaller
            than the cells of the grid, κ grows with the ratio of their heights.
        stiffness_per_area: κ itself (Pa/m), instead of `penalty`; at least 0.05 E/h.
        slip_stiffness: Tangential stiffness during stick, as a share of κ.
        penetration: Largest penetration (m), or None for the penalty alone.

    Raises:
        ParameterError: An argument has the wrong type or a value outside its range.
        UnsupportedGridError: The grid is not rectangular.

    Two blocks, one on the other:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> lower = mpm.fill(grid, mpm.Box((0, 0), (4, 1)), per_cell=2, density=2000.0, tag=1)
    >>> points = lower + mpm.fill(grid, mpm.Box((1, 1), (3, 2)), per_cell=2, density=2000.0, tag=2)
    >>> A, B = mpm.Space(grid, "gimp", tag=1), mpm.Space(grid, "gimp", tag=2)
    >>> top = mpm.Boundary.from_polygon(points, [(4, 1), (0, 1)], closed=False)
    >>> bottom = mpm.Boundary.from_polygon(points, [(1, 1), (3, 1)], closed=False)
    >>> u, v = (B.increment, A.increment), (B.test, A.test)
    >>> term = mpm.contact_between((bottom, top), u, v, friction=0.3)
    >>> round(bottom.total_area, 9), round(top.total_area, 9)
    (2.0, 4.0)
    """
    first, second = _pair("boundaries", boundaries)
    for one in (first, second):
        if not isinstance(one, Boundary):
            raise ParameterError(
                f"boundaries holds {shown(one)}, no mpm.Boundary: make a boundary along each body, "
                "such as with mpm.Boundary.from_polygon"
            )
        if not (one.follows and one.activates):
            raise ParameterError(
                f"{one} stays in space or makes no cells active; boundaries that touch follow "
                "their bodies: leave follows and activates as they are by default"
            )
    if first is second or first.points is not second.points:
        raise ParameterError(
            "contact_between takes two boundaries, each of a body, of the same material points: "
            "tag the points of each, join the bodies with + and give each a boundary"
        )
    points = first.points
    if points.axisymmetric:
        raise ParameterError(
            "contact_between is of plane and 3D bodies, and these points are axisymmetric; let a "
            "mpm.RigidBody touch them, or hold them with mpm.dirichlet"
        )
    require_lattice(points.grid, "contact_between")
    for one, test in zip(_pair("u", u), _pair("v", v)):
        check_displacement(points, u=one, v=test)
    spaces: list[Any] = [getattr(one, "_dolfinmpm_space", None) for one in u]
    tags = [getattr(space, "tags", None) for space in spaces]
    own = [set(one or ()) for one in tags]
    if u[0] is u[1] or not all(own) or own[0] & own[1]:
        raise ParameterError(
            f"u are increments of fields of the tags {tags[0]} and {tags[1]}; bodies that touch "
            "have fields of their own, Space(..., tag=1) and Space(..., tag=2)"
        )
    if any(test != space.test for test, space in zip(v, spaces)):
        raise ParameterError(
            "v are not the test functions of the fields of u, in their order; give "
            "(one.increment, other.increment) and (one.test, other.test)"
        )
    law = ContactLaw(
        friction, penalty, stiffness_per_area, slip_stiffness, penetration, shear_limit
    )
    return as_form(TwoBodyContact((first, second), (u[0], u[1]), law), u[0], v[0])


def _pair(name: str, given: Any) -> tuple[Any, Any]:
    if not isinstance(given, (tuple, list)) or len(given) != 2:
        many = len(given) if isinstance(given, (tuple, list)) else shown(given)
        raise ParameterError(f"{name} = {many} must be two, one for each of the bodies that touch")
    return given[0], given[1]
