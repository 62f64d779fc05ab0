"""Walls that push but do not pull: Signorini's conditions, with or without Coulomb friction.

The normal n of a wall points outwards, away from the body. The gap g at a marker is positive if the
body is behind the wall. The pressure p and the traction t of the wall on the body are

    p = k ⟨g⟩,   t = −p n + t_s,   |t_s| ≤ μ p.

The shear t_s is t_s,n − k_t P u with P = I − n⊗n, returned to Coulomb's bound. The gap is the gap
at the start of the step plus n·u. It continues below zero, so that a body that lifts off returns at
the same place. At markers without earlier contact, the gap is the distance from the nearest point's
domain.

In implicit steps with a consistent mass, this contact oscillates, like any stiff penalty. Steps
that do not resolve its oscillations may multiply the energy of an impact, also those of
`GeneralisedAlpha` with ρ∞ = 0.8. A lumped mass, or ρ∞ = 0, damps the oscillations, and takes some
energy. A step ends with an `InstabilityError` where walls at rest have given a tenth of the energy.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from ufl.core.expr import Expr

from dolfinmpm._platform.argumentchecks import check_kind, number, refuse_idle
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm._platform.units import LARGEST_FRICTION, friction_coefficient
from dolfinmpm.body.boundary import Boundary
from dolfinmpm.body.formarguments import check_displacement
from dolfinmpm.body.formsigns import signed_form
from dolfinmpm.body.markerstate import keys_of, nearest
from dolfinmpm.forms.declarations import Declaration, subdomain
from dolfinmpm.grid.constants import own_constant
from dolfinmpm.grid.lattice import largest_cell
from dolfinmpm.kinematics.lawterms import flux
from dolfinmpm.kinematics.walldistance import in_front, look_ahead
from dolfinmpm.materials.base import Law
from dolfinmpm.materials.neohookean import NeoHookean

__all__ = ["Wall", "signorini"]

# Penalties in units of M/h: the body gets into a wall by a hundredth of a cell's compression. Slip
# that sticks is softer by far. Newton's method takes all that slides for sliding on, without
# stiffness; where the wall were much stiffer than the body, the next iteration would have it slide
# back, and so on.
_PENALTY, _SLIP = 1e2, 0.5
# Markers so many cells apart touch the same part of a body that slides
_NEAR = 1.0
# A body so near in units of a cell touches
_TOUCHES = 1e-9
# Tractions so near to the limit of friction, as a share, are at it
_ROUNDING = 1e-14
# slip below this share of a cell has no direction
_STILL = 1e-12


@dataclass(frozen=True, eq=False)
class Wall:
    """A wall and its fields at the markers.

    Attributes:
        boundary: The wall.
        declaration: The law at the markers; None where the stiffness is given.
        fixed: Penalty (Pa/m), or None.
        penalty: Penalty in units of M/h.
        name: First part of the names of its fields.
        friction: Coefficient μ of Coulomb's friction.
        slip: Stiffness against slip over the penalty.
        stiffness: Name of the markers' field of the penalty k (Pa/m).
        updates: Fields that a step sets, by name.
    """

    boundary: Boundary
    declaration: Declaration | None
    fixed: float | None
    penalty: float
    name: str
    friction: float
    slip: float
    stiffness: str
    updates: dict[str, Expr]
    local = False
    exact = False

    def __repr__(self) -> str:
        return f"the wall at '{self.boundary.name}'"

    def stiffness_per_area(self) -> npt.NDArray[np.float64]:
        """The penalty at the markers of this rank (Pa/m), shape (markers,)."""
        return self.boundary.markers[self.stiffness]

    def stiffest(self) -> npt.NDArray[np.float64]:
        """Largest stiffness at the markers of this rank (Pa/m), 0 if no body is in front."""
        markers = self.boundary.markers
        return max(1.0, self.slip) * markers[self.stiffness] * markers[f"{self.name}_on"]

    def states(self) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
        """Which markers of this rank touch, and which of them slip, after a step."""
        markers = self.boundary.markers
        gap, k = markers[f"{self.name}_gap"], markers[self.stiffness]
        touches = gap > 0.0
        bound = min(self.friction, LARGEST_FRICTION) * k * gap
        held = np.linalg.norm(markers[f"{self.name}_shear"], axis=1)
        # the tractions of markers that slip are those of the limit, to rounding
        return touches, touches & (self.friction > 0.0) & (held > (1.0 - _ROUNDING) * bound)

    def energy(self) -> tuple[float, float]:
        """Energy stored by the penalties, and work of friction so far, at this rank's markers (J).

        Penalties store ½ k ⟨g⟩² + ½ |t_s|²/k_t per area.
        """
        markers = self.boundary.markers
        k, gap = markers[self.stiffness], np.maximum(markers[f"{self.name}_gap"], 0.0)
        stored = float(np.sum(0.5 * markers["V"] * k * gap**2))
        if not self.slip:
            return stored, 0.0
        shear = np.sum(markers[f"{self.name}_shear"] ** 2, axis=1)
        resists = np.where(k > 0.0, self.slip * k, np.inf)
        stored += float(np.sum(0.5 * markers["V"] * shear / resists))
        return stored, float(np.sum(markers[f"{self.name}_rubbed"]))

    def own_work(
        self,
        fields: Mapping[str, npt.NDArray[np.float64]],
        moved: npt.NDArray[np.float64],
        level: Mapping[str, npt.NDArray[np.float64]] | None = None,
    ) -> float:
        """Work of the wall in a step at this rank's markers (J), before the step is taken.

        Args:
            fields: New values of the markers' fields.
            moved: Displacements of the body at the markers (m), shape (markers, d).
            level: The fields at the time at which forces balance, if it is within the step. The
                work is then that of the forces at this time.
        """
        markers = self.boundary.markers
        if level is not None:
            return float(np.sum(level[f"{self.name}_force"] * moved))
        p = markers[self.stiffness] * np.maximum(markers[f"{self.name}_gap"], 0.0)
        force = markers["V"][:, None] * markers[f"{self.name}_shear"]
        force -= p[:, None] * markers["area"]
        return 0.5 * float(np.sum((force + fields[f"{self.name}_force"]) * moved))

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
        on, distance = in_front(self.boundary, rows)
        gap, known = markers[f"{name}_gap"], markers[f"{name}_on"]
        new, shear = on & (known == 0.0), markers[f"{name}_shear"]
        touches = distance < _TOUCHES * largest_cell(markers.grid)
        gap[new] = np.where(touches, 0.0, -distance)[new]
        self._inherit(new, known > 0.0, (gap, shear))
        gap[~on], shear[~on] = 0.0, 0.0
        known[:] = on

    def _inherit(
        self,
        new: npt.NDArray[np.bool_],
        old: npt.NDArray[np.bool_],
        fields: tuple[npt.NDArray[np.float64], ...],
    ) -> None:
        """Copy fields from near markers with the body to markers that the body reaches. Collective.

        Args:
            new: Whether the body reaches each marker in this step, shape (markers,).
            old: Whether the body was at each marker in the last step, shape (markers,).
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


def _returned(grid: mesh.Mesh, trial: Expr, stick: Expr, bound: Expr, on: Expr) -> Any:
    """The shear traction (Pa): the trial one if it sticks, or one of the size of its bound."""
    least = stick * own_constant(grid, _STILL * largest_cell(grid))
    size = ufl.sqrt(ufl.dot(trial, trial) + least**2)
    # the traction is continuous at the bound, so that Newton's method takes either branch
    return on * ufl.conditional(ufl.gt(size, bound), bound / size, 1.0) * trial


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
    penalty: float = _PENALTY,
    slip_penalty: float = _SLIP,
    stiffness_per_area: float | None = None,
) -> ufl.Form:
    """A wall that takes compression but no tension: a term to add to a form.

    Args:
        boundary: The wall, such as `Boundary.from_side(points, "right")`; its normal points
            out of the body's room.
        u: Increment of the step, `Space.increment`.
        v: Test function, `Space.test`.
        law: The law of the body at the wall, whose modulus scales the penalty; None with a
            stiffness per area.
        friction: Coefficient μ of Coulomb's friction.
        strain, tag: As for `momentum`; the wall acts where the nearest point has the tag.
        penalty: k in units of M/h; see `dirichlet`, also for what explicit steps bear.
        slip_penalty: Stiffness against slip that sticks, likewise.
        stiffness_per_area: k itself (Pa/m), instead; that against slip is slip_penalty/penalty
            of it.

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
    number("penalty", penalty, 0.0), number("slip_penalty", slip_penalty, 0.0)
    if d == 1:
        refuse_idle("friction", mu, 0.0, "in 1D nothing slides along a wall; leave it out")
    if not mu:
        refuse_idle("slip_penalty", slip_penalty, 0.5, "it is of friction: give friction=")
    _check_stiffness(stiffness_per_area, law, tag)
    declaration = None if law is None else flux(law, markers, u, strain, tag)[1]
    name = f"wall{len(boundary.forces) + 1}"
    look_ahead(boundary)
    gap = markers.add_field(f"{name}_gap", (), "m")
    shear = markers.add_field(f"{name}_shear", (d,), "Pa")
    on = markers.add_field(f"{name}_on")
    k = markers.add_field(f"{name}_stiffness", (), "Pa/m")
    force = markers.add_field(f"{name}_force", (d,), "N")
    n = boundary.normal
    g = on * (gap + ufl.dot(n, u))
    # a body that just touches is pushed back from the first iteration on
    p = k * ufl.conditional(ufl.ge(g, 0.0), g, 0.0)
    traction = -p * n
    updates = {gap.name: g}
    if mu > 0:
        stick = k * own_constant(markers.grid, slip_penalty / penalty)
        # with an infinite μ, too, nothing holds a body that has lifted off
        bound = own_constant(markers.grid, min(mu, LARGEST_FRICTION)) * p
        trial = shear - stick * (u - ufl.dot(n, u) * n)
        returned = _returned(markers.grid, trial, stick, bound, on)
        traction += returned
        updates[shear.name] = returned
        rubbed = markers.add_field(f"{name}_rubbed", (), "J")
        # slip without that of the stiffness, against the mean of the tractions
        slipped = (trial - returned) / ufl.conditional(ufl.gt(stick, 0.0), stick, 1.0)
        updates[rubbed.name] = rubbed + 0.5 * ufl.dot(shear + returned, slipped) * markers.V
    updates[force.name] = traction * markers.V
    boundary.forces.append(force.name)
    slip = slip_penalty / penalty if mu > 0 else 0.0
    wall = Wall(
        boundary, declaration, stiffness_per_area, float(penalty), name, mu, slip, k.name, updates
    )
    mark = {**boundary.ds.metadata(), "condition": wall}
    tags = None if declaration is None else declaration.tags
    ds = boundary.ds(subdomain(tags), metadata=mark)
    return signed_form(-ufl.dot(traction, v), ds, f"the wall (mpm.signorini) at '{boundary.name}'")
