"""Walls that push but do not pull: Signorini's conditions, with or without Coulomb friction.

The normal n of a wall points outwards, away from the body. The gap g at a marker is positive if the
body is behind the wall. The pressure p and the traction t of the wall on the body are

    p = k ⟨g⟩,   t = −p n + t_s,   |t_s| ≤ μ p.

The shear t_s is t_s,n − k_t P u with P = I − n⊗n, returned to Coulomb's bound. The gap is the gap
at the start of the step plus n·u. It continues below zero, so that a body that lifts off returns at
the same place. At markers without earlier contact, the gap is the distance from the nearest point's
domain.

In implicit steps with inertia the mean of these forces over the step acts, which makes no energy.
With q = g at the start (0) and at the end (1) of the step,

    p̄ = k (⟨q₁⟩² − ⟨q₀⟩²) / (2 (q₁ − q₀)),    t̄_s = (t₀ + t₁)/2,   |t̄_s| ≤ μ p̄,

so that p̄ (q₁ − q₀) is the change of the stored energy ½ k ⟨g⟩² (Laursen & Chawla 1997). See
`dolfinmpm.contact.meanforces` for the same with rigid bodies.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from mpi4py import MPI
from ufl.core.expr import Expr

from dolfinmpm._platform.argumentchecks import check_kind, number, refuse_idle
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm._platform.units import LARGEST_FRICTION, LARGEST_PENALTY, friction_coefficient
from dolfinmpm.body.boundary import Boundary
from dolfinmpm.body.formarguments import check_displacement
from dolfinmpm.body.markerstate import keys_of, nearest
from dolfinmpm.forms.declarations import Declaration
from dolfinmpm.grid.constants import own_constant
from dolfinmpm.grid.lattice import largest_cell
from dolfinmpm.kinematics.lawterms import flux
from dolfinmpm.kinematics.nitsche import condition_form
from dolfinmpm.kinematics.walldistance import in_front, look_ahead
from dolfinmpm.kinematics.walltractions import WallTractions
from dolfinmpm.materials.base import Law
from dolfinmpm.materials.neohookean import NeoHookean

__all__ = ["Wall", "signorini"]

# Penalties in units of M/h: the body gets into a wall by a hundredth of a cell's compression, in
# explicit steps by a tenth, because stiff walls need short steps
_PENALTY, _EXPLICIT = 1e2, 10.0
# Stiffness against slip that sticks, in units of M/h. It is softer by far: Newton's method takes
# all that slides for sliding on, without stiffness; where the wall were much stiffer than the body,
# the next iteration would have it slide back, and so on. In steps with inertia it is a share of
# the penalty: inertia keeps such iterations apart.
_SLIP, _SLIP_IN_TIME = 0.5, 0.5
# Stiffness that explicit steps count, as a multiple: they take half of the length that is stable. A
# penalty that begins to act within a longer step makes up to a tenth of an impact's energy.
_COUNTS = 4.0
# Markers so many cells apart touch the same part of a body that slides
_NEAR = 1.0
# A body so near in units of a cell touches
_TOUCHES = 1e-9
# slip below this share of a cell has no direction
_STILL = 1e-12


@dataclass(eq=False)
class Wall:
    """A wall and its fields at the markers.

    Attributes:
        boundary: The wall.
        declaration: The law at the markers; None where the stiffness is given.
        fixed: Penalty (Pa/m), or None.
        given_penalty: Penalty in units of M/h, or None for one that the steps choose.
        name: First part of the names of its fields.
        friction: Coefficient μ of Coulomb's friction.
        given_slip: Stiffness against slip in units of M/h, or None for one that the steps choose.
        slip: Stiffness against slip over the penalty.
        stiffness: Name of the markers' field of the penalty k (Pa/m).
        updates: Fields that a step sets, by name.
        u: Increment of the body's displacement.
        weight: Weight of the mean force over the step in the balance; 0 for the force at its end.
        scale: Increments at the end of the step over those at the time of the balance.
        penalty: The penalty of the present steps, in units of M/h.
    """

    boundary: Boundary
    declaration: Declaration | None
    fixed: float | None
    given_penalty: float | None
    name: str
    friction: float
    given_slip: float | None
    slip: fem.Constant
    stiffness: str
    updates: dict[str, Expr]
    u: fem.Function
    weight: fem.Constant
    scale: fem.Constant
    penalty: float = _PENALTY
    local = False
    exact = False
    pushes = True

    def __repr__(self) -> str:
        return f"the wall at '{self.boundary.name}'"

    @property
    def forces(self) -> tuple[str, ...]:
        """Names of the markers' fields of forces on the body (N)."""
        return f"{self.name}_force", f"{self.name}_acting"

    def stiffness_per_area(self) -> npt.NDArray[np.float64]:
        """The penalty at the markers of this rank (Pa/m), shape (markers,)."""
        return self.boundary.markers[self.stiffness]

    def stiffest(self) -> npt.NDArray[np.float64]:
        """Stiffness that counts in explicit steps at the markers (Pa/m), 0 without a body there."""
        markers = self.boundary.markers
        k = _COUNTS * max(1.0, float(self.slip.value)) * markers[self.stiffness]
        return k * markers[f"{self.name}_on"]

    def states(self) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
        """Which markers of this rank touch, and which of them slip, after a step."""
        markers = self.boundary.markers
        touches = markers[f"{self.name}_gap"] > 0.0
        if not self.friction:
            return touches, np.zeros_like(touches)
        return touches, touches & (markers[f"{self.name}_slips"] > 0.0)

    def energy(self) -> tuple[float, float]:
        """Energy stored by the penalties, and work of friction so far, at this rank's markers (J).

        Penalties store ½ k ⟨g⟩² + ½ |t_s|²/k_t per area.
        """
        markers = self.boundary.markers
        k, gap = markers[self.stiffness], np.maximum(markers[f"{self.name}_gap"], 0.0)
        stored = float(np.sum(0.5 * markers["V"] * k * gap**2))
        slip = float(self.slip.value)
        if not slip:
            return stored, 0.0
        shear = np.sum(markers[f"{self.name}_shear"] ** 2, axis=1)
        resists = np.where(k > 0.0, slip * k, np.inf)
        stored += float(np.sum(0.5 * markers["V"] * shear / resists))
        return stored, float(np.sum(markers[f"{self.name}_rubbed"]))

    def own_work(
        self,
        fields: Mapping[str, npt.NDArray[np.float64]],
        moved: npt.NDArray[np.float64],
    ) -> float:
        """Work of the wall in an explicit step at this rank's markers (J), before it is taken.

        Args:
            fields: New values of the markers' fields.
            moved: Displacements of the body at the markers (m), shape (markers, d).
        """
        markers = self.boundary.markers
        p = markers[self.stiffness] * np.maximum(markers[f"{self.name}_gap"], 0.0)
        force = markers["V"][:, None] * markers[f"{self.name}_shear"]
        force -= p[:, None] * markers["area"]
        return 0.5 * float(np.sum((force + fields[f"{self.name}_force"]) * moved))

    def act(self, in_time: bool, weights: Any) -> None:
        """Act in the steps of a problem.

        Args:
            in_time: Whether its steps have inertia. Then friction is stiff, unless its stiffness
                is given: traction that grows with the slip of a body that hops is not that of its
                pressure.
            weights: Weights of mean forces, see `dolfinmpm.contact.meanforces`; None for forces at
                an end of the step.
        """
        self.weight.value = 0.0 if weights is None else weights.weight
        self.scale.value = 1.0 if weights is None else weights.scale
        self.penalty = self.given_penalty or (_EXPLICIT if in_time and not weights else _PENALTY)
        if self.friction:
            stiff = _SLIP_IN_TIME * self.penalty if in_time else _SLIP
            self.slip.value = (self.given_slip or stiff) / self.penalty

    def prepare(self, rows: npt.NDArray[np.integer], sizes: npt.NDArray[np.float64]) -> None:
        """Set the penalty, and find the markers with the body in front and their gaps.

        Args:
            rows: Markers in active cells.
            sizes: Sizes h of the cells at the markers (m), shape (markers,).
        """
        markers, name = self.boundary.markers, self.name
        k = markers[self.stiffness]
        if self.fixed is not None:
            k[:] = self.fixed
        elif self.declaration is not None:
            M = self.declaration.elastic.moduli()[:, 0]
            rows_of = self.declaration.rows
            k[rows_of] = self.penalty * M / sizes[rows_of]
        on, distance = in_front(self.boundary, rows, sizes)
        gap, known = markers[f"{name}_gap"], markers[f"{name}_on"]
        new, shear = on & (known == 0.0), markers[f"{name}_shear"]
        touches, pressed = distance < _TOUCHES * largest_cell(markers.grid), gap > 0.0
        gap[new] = np.where(touches, 0.0, -distance)[new]
        # a body that rolls is further away than at the markers that it presses on
        there = distance.copy()
        self._inherit(new & touches, pressed, (gap, shear, there))
        gap -= np.maximum(distance - there, 0.0)
        gap[~on], shear[~on | (gap < 0.0)] = 0.0, 0.0
        known[:] = on

    def _inherit(
        self,
        new: npt.NDArray[np.bool_],
        old: npt.NDArray[np.bool_],
        fields: tuple[npt.NDArray[np.float64], ...],
    ) -> None:
        """Copy fields from near markers under pressure to those that the body reaches. Collective.

        Args:
            new: Whether the body comes to touch each marker in this step, shape (markers,).
            old: Whether the body pressed on each marker in the last step, shape (markers,).
            fields: Fields of the markers; changed.
        """
        markers, comm = self.boundary.markers, self.boundary.points.comm
        if not comm.allreduce(bool(new.any()), op=MPI.LOR):
            return
        x = np.concatenate(comm.allgather(markers["x"][old]))
        values = [np.concatenate(comm.allgather(values[old])) for values in fields]
        rows = np.flatnonzero(new)
        distance, _, of = nearest(x, keys_of(x), markers["x"][rows])
        near = distance < _NEAR * largest_cell(markers.grid)
        for to, source in zip(fields, values):
            to[rows[near]] = source[of[near]]


def _check_stiffness(stiffness_per_area: Any, law: Any, tag: Any) -> None:
    """Raise ParameterError unless the stiffness is given by the law, or by itself."""
    if stiffness_per_area is None:
        if law is None:
            raise ParameterError(
                "law = None needs a stiffness_per_area (Pa/m); give the law of the body"
            )
        return
    number("stiffness_per_area", stiffness_per_area, 0.0, unit="Pa/m")
    for what, given in (("law", law), ("tag", tag)):
        refuse_idle(what, given, None, "leave it out, or leave out stiffness_per_area")


@collective
def signorini(
    boundary: Boundary,
    u: fem.Function,
    v: Any,
    *,
    law: Law | NeoHookean | None = None,
    friction: float = 0.0,
    strain: str = "large",
    tag: int | tuple[int, ...] | None = None,
    penalty: float | None = None,
    slip_penalty: float | None = None,
    stiffness_per_area: float | None = None,
) -> ufl.Form:
    """A wall that takes compression but no tension: a term to add to a form.

    Args:
        boundary: The wall, such as `Boundary.from_side(points, "right")`. Its normal points away
            from the body.
        u: Increment of the step, `Space.increment`.
        v: Test function, `Space.test`.
        law: The law of the body at the wall, whose modulus scales the penalty; None with a
            stiffness per area.
        friction: Coefficient μ of Coulomb's friction (-), not negative.
        strain, tag: As for `momentum`; the wall acts where the nearest point has the tag.
        penalty: k in units of M/h, see `dirichlet`: by default 100, and 10 in explicit steps.
        slip_penalty: Stiffness against elastic slip while the body sticks, in units of M/h. The
            default is 0.5. In steps with inertia, where a body may hop, it is half of the penalty.
        stiffness_per_area: k itself (Pa/m), instead of `penalty`. The stiffness against slip is
            then slip_penalty/penalty times this one.

    Raises:
        ParameterError: An argument is not valid; the boundary moves with a body; or law and
            stiffness are both missing, or both given.

    A body is pushed to the right, against a wall:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    >>> V = mpm.Space(grid, "gimp")
    >>> F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, V.increment, V.test)
    >>> wall = mpm.Boundary.from_side(points, "right")
    >>> F += mpm.signorini(wall, V.increment, V.test, law=mpm.materials.Hencky(1e6, 0.3))
    >>> push = mpm.prescribed(V, "left", 0, increment=0.01) + mpm.rollers(V, "bottom")
    >>> record = mpm.QuasiStatic(F, V.increment, points, push).step()
    >>> round(float(wall.force()[0]), -2)
    -5500.0
    """
    check_kind(
        "boundary", boundary, Boundary, 'make it with mpm.Boundary.from_side(points, "left")'
    )
    markers, d = boundary.markers, boundary.points.gdim
    check_displacement(boundary.points, u=u, v=v)
    if boundary.activates or boundary.follows:
        raise ParameterError(
            f"{boundary} belongs to a body (follows=True or activates=True); make a wall with "
            "mpm.Boundary.from_side, or with follows=False, activates=False"
        )
    mu = friction_coefficient(friction)
    for what, given in (("penalty", penalty), ("slip_penalty", slip_penalty)):
        if given is not None:
            number(what, given, 0.0, LARGEST_PENALTY)
    if d == 1:
        refuse_idle("friction", mu, 0.0, "in 1D nothing slides along a wall; leave it out")
    if not mu:
        refuse_idle("slip_penalty", slip_penalty, None, "it is of friction: give friction=")
    _check_stiffness(stiffness_per_area, law, tag)
    declaration = None if law is None else flux(law, markers, u, strain, tag)[1]
    name = f"wall{len(boundary.forces) + 1}"
    look_ahead(boundary)
    gap = markers.add_field(f"{name}_gap", (), "m")
    shear = markers.add_field(f"{name}_shear", (d,), "Pa")
    on = markers.add_field(f"{name}_on")
    k = markers.add_field(f"{name}_stiffness", (), "Pa/m")
    force = markers.add_field(f"{name}_force", (d,), "N")
    acting = markers.add_field(f"{name}_acting", (d,), "N")
    if mu > 0:
        markers.add_field(f"{name}_slips")
    rubbed = markers.add_field(f"{name}_rubbed", (), "J")
    weight, scale = own_constant(markers.grid, 0.0), own_constant(markers.grid, 1.0)
    slip = own_constant(markers.grid, 0.0)
    tractions = WallTractions(
        boundary.normal, markers.V, on, gap, shear, rubbed, k,
        stick=k * slip,
        # with an infinite μ, too, nothing holds a body that has lifted off
        friction=own_constant(markers.grid, min(mu, LARGEST_FRICTION)) if mu > 0 else None,
        still=own_constant(markers.grid, _STILL * largest_cell(markers.grid)),
        weight=weight,
    )  # fmt: skip
    traction = tractions.in_balance(scale * u)
    updates = {f"{name}_{key}": value for key, value in tractions.new_fields(u).items()}
    updates[force.name] = tractions.mean_or_end(u) * markers.V
    updates[acting.name] = traction * markers.V
    boundary.forces.append(force.name)
    wall = Wall(
        boundary, declaration, stiffness_per_area, penalty, name, mu, slip_penalty, slip,
        k.name, updates, u, weight, scale,
    )  # fmt: skip
    wall.act(False, None)
    return condition_form(wall, -ufl.dot(traction, v), "the wall (mpm.signorini)")
