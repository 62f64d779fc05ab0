"""Walls that push but do not pull: Signorini's conditions, with Coulomb friction or without.

At a marker of a wall with outward normal n, where the body would go to, the gap g (positive where
the body is too far out) and the traction of the wall on the body are

    p = k ⟨g⟩,   t = −p n + t_s,   |t_s| ≤ μ p,

with the shear t_s that Coulomb's law returns of t_s,n − k_t P u, P = I − n⊗n. The gap is that of
the start of the step plus n·u, and goes on below zero: what lifts off comes back where it left.
Where a wall has had no contact yet, the gap is the way from the nearest point's domain.

In steps in time such contact oscillates under the trapezoidal rule with a consistent mass, as any
penalty does; a lumped mass or `GeneralisedAlpha` with ρ∞ < 1 damps it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from mpi4py import MPI
from ufl.core.expr import Expr

from dolfinmpm._platform.checks import check_kind, number
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm._platform.together import together
from dolfinmpm._platform.units import friction_coefficient
from dolfinmpm.body.acting import acting
from dolfinmpm.body.boundary import Boundary
from dolfinmpm.body.formarguments import check_displacement
from dolfinmpm.body.markerstate import keys_of, nearest
from dolfinmpm.forms.declarations import Declaration
from dolfinmpm.grid.constants import own_constant
from dolfinmpm.grid.lattice import largest_cell
from dolfinmpm.kinematics.coverage import in_front, look_ahead
from dolfinmpm.kinematics.lawterms import flux
from dolfinmpm.materials.base import Law
from dolfinmpm.materials.neohookean import NeoHookean

__all__ = ["Wall", "signorini"]

# Penalties in units of M/h: the body gets into a wall by a hundredth of a cell's compression. Slip
# that sticks is softer by far. Newton's method takes all that slides for sliding on, without
# stiffness; where the wall were much stiffer than the body, the next iteration would have it slide
# back, and so on.
_BETA, _SLIP = 1e2, 0.5
# Markers so many cells apart touch the same part of a body that slides
_NEAR = 1.0
# slip below this share of a cell has no direction
_STILL = 1e-12


@dataclass(frozen=True, eq=False)
class Wall:
    """What a wall keeps at its markers.

    Attributes:
        boundary: The wall.
        declaration: The law at the markers; None where the stiffness is given.
        fixed: Penalty (Pa/m), or None.
        beta: Penalty in units of M/h.
        name: First part of the names of its fields.
        slip: Stiffness against slip over the penalty.
        stiffness: Name of the markers' field of the penalty k (Pa/m).
        updates: Fields that a step sets, by name.
    """

    boundary: Boundary
    declaration: Declaration | None
    fixed: float | None
    beta: float
    name: str
    slip: float
    stiffness: str
    updates: dict[str, Expr]
    local = False
    exact = False

    def stiffest(self) -> npt.NDArray[np.float64]:
        """Largest stiffness at the markers of this rank, 0 where no body is in front (Pa/m)."""
        markers = self.boundary.markers
        return max(1.0, self.slip) * markers[self.stiffness] * markers[f"{self.name}_on"]

    def prepare(self, rows: npt.NDArray[np.integer]) -> None:
        """Find where the body is in front of the wall, and how far.

        Args:
            rows: Markers in active cells.
        """
        markers, name = self.boundary.markers, self.name
        k = markers[self.stiffness]
        if self.fixed is not None:
            k[:] = self.fixed
        elif self.declaration is not None:
            of_law = self.declaration.rows
            k[of_law] = self.beta * self.declaration.moduli()[:, 0] / largest_cell(markers.grid)
        on, way = in_front(self.boundary, rows)
        gap, known = markers[f"{name}_gap"], markers[f"{name}_on"]
        new, shear = on & (known == 0.0), markers[f"{name}_shear"]
        gap[new] = np.minimum(-way, 0.0)[new]
        self._inherit(new, known > 0.0, (gap, shear))
        gap[~on], shear[~on] = 0.0, 0.0
        known[:] = on

    def _inherit(
        self,
        new: npt.NDArray[np.bool_],
        old: npt.NDArray[np.bool_],
        fields: tuple[npt.NDArray[np.float64], ...],
    ) -> None:
        """Give markers that the body comes to what those have that it is at. Collective.

        Args:
            new: Markers that it comes to.
            old: Those that it was at in the last step.
            fields: Changed.
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


@together
def signorini(
    boundary: Boundary,
    u: fem.Function,
    v: Any,
    *,
    law: Law | NeoHookean | None = None,
    friction: float = 0.0,
    strain: str = "large",
    tag: int | tuple[int, ...] | None = None,
    beta: float = _BETA,
    slip_beta: float = _SLIP,
    stiffness: float | None = None,
) -> ufl.Form:
    """A wall that takes compression but no tension, to be added.

    Args:
        boundary: The wall, such as `Boundary.from_side(points, "right")`; its normal points
            out of the body's room.
        u: Increment of the step, `Space.increment`.
        v: Test function, `Space.test`.
        law: The law of the body at the wall, whose modulus scales the penalty; None with a
            stiffness.
        friction: Coefficient μ of Coulomb's friction.
        strain, tag: As for `momentum`; the wall acts where the nearest point has the tag.
        beta: Penalty in units of M/h; see `dirichlet`, also for what explicit steps bear.
        slip_beta: Stiffness against slip that sticks, likewise.
        stiffness: Penalty k (Pa/m), instead; that against slip is by slip_beta/beta of it.

    Raises:
        ParameterError: An argument is not what it may be.
    """
    check_kind(
        "boundary", boundary, Boundary, 'make it with mpm.Boundary.from_side(points, "left")'
    )
    markers, d = boundary.markers, boundary.points.gdim
    check_displacement(boundary.points, u=u, v=v)
    if boundary.activates or boundary.follows:
        raise ParameterError(
            f"{boundary} is one of a body, with follows=True or activates=True; make a wall with "
            "mpm.Boundary.from_side, or with follows=False, activates=False"
        )
    mu = friction_coefficient(friction)
    number("beta", beta, 0.0), number("slip_beta", slip_beta, 0.0)
    declaration = None
    if stiffness is not None:
        number("stiffness", stiffness, 0.0, unit="Pa/m")
    elif law is None:
        raise ParameterError("law = None needs a stiffness (Pa/m); give the law of the body")
    else:
        declaration = flux(law, markers, u, strain, tag)[1]
    name = f"wall{len(boundary.forces) + 1}"
    look_ahead(boundary)
    gap = markers.add_field(f"{name}_gap", (), "m")
    shear = markers.add_field(f"{name}_shear", (d,), "Pa")
    on = markers.add_field(f"{name}_on")
    k = markers.add_field(f"{name}_stiffness", (), "Pa/m")
    force = markers.add_field(f"{name}_force", (d,), "N")
    n = boundary.normal
    g = on * (gap + ufl.dot(n, u))
    p = k * ufl.conditional(ufl.gt(g, 0.0), g, 0.0)
    traction = -p * n
    updates = {gap.name: g}
    if mu > 0 and d > 1:
        stick = k * own_constant(markers.grid, slip_beta / beta)
        bound = own_constant(markers.grid, mu) * p
        trial = shear - stick * (u - ufl.dot(n, u) * n)
        least = stick * own_constant(markers.grid, _STILL * largest_cell(markers.grid))
        size = ufl.sqrt(ufl.dot(trial, trial) + least**2)
        # continuous where slip begins, so that Newton's method sees one branch or the other
        slides = ufl.gt(size, bound)
        rubbed = on * ufl.conditional(slides, bound / size, 1.0) * trial
        traction += rubbed
        updates[shear.name] = rubbed
    updates[force.name] = traction * markers.V
    boundary.forces.append(force.name)
    slip = slip_beta / beta if mu > 0 else 0.0
    wall = Wall(boundary, declaration, stiffness, float(beta), name, slip, k.name, updates)
    mark = {**boundary.ds.metadata(), "condition": wall}
    where: Any = "everywhere"
    if declaration is not None and declaration.tags is not None:
        where = declaration.tags if len(declaration.tags) > 1 else declaration.tags[0]
    ds = boundary.ds(where, metadata=mark)
    return acting(-ufl.dot(traction, v), ds, f"the wall (mpm.signorini) at '{boundary.name}'")
