"""Problems that the fused loops support, and their loads for the loops."""

from __future__ import annotations

from collections.abc import Set
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from ufl.algorithms import extract_arguments
from ufl.constantvalue import Zero

from dolfinmpm.basis import LatticeBasis
from dolfinmpm.dynamics.explicitbase import Settings
from dolfinmpm.dynamics.facesatnodes import Sides
from dolfinmpm.dynamics.mass import point_masses
from dolfinmpm.dynamics.passes import NEO
from dolfinmpm.dynamics.pointarrays import formulation_of
from dolfinmpm.forms.termqueries import depends_on, summands, term_of
from dolfinmpm.grid.constants import is_own
from dolfinmpm.kinematics.fbar import VOLUMES
from dolfinmpm.materials.umat import UMAT
from dolfinmpm.solve.weakform import WeakForm

__all__ = ["FusedLoads", "why_not"]

Array = npt.NDArray[np.float64]
# Fields that a step changes: a load that depends on them is evaluated in every step
_FIXED = ("density", "V0", "x0", "l0")
# Fields that loads depend on
_OF_LOADS = frozenset((*_FIXED, "tag"))


def why_not(problem: Any, settings: Settings, sides: Sides, options: dict[str, Any]) -> str | None:
    """Reason why the fused loops do not support a problem, or None.

    Args:
        problem: The problem.
        settings: Settings of the steps.
        sides: Sides of the grid that act on the body.
        options: Other arguments of the problem.
    """
    field = problem.fields[0]
    if not isinstance(field.space.basis, LatticeBasis):
        return "the grid is not rectangular"
    if field.space.refinement is not None:
        return "the space is refined"
    if problem.terms.kind != "lumped":
        return "the mass is consistent"
    if not settings.plain:
        return "bulk viscosity or filters of light nodes act"
    if problem.essential_conditions.follows:
        return "a condition follows the body (follows=True)"
    tied = field.stabilisation.constrains_nodes or options.get("prolongation")
    if tied or options.get("updates"):
        return "constraints act between nodes, or a step updates fields"
    if settings.mapping.kind not in ("flip", "pic", "apic", "tpic"):
        return "the mapping filters velocities at the nodes"
    reason = _why_not_the_form(problem.form)
    if reason is not None:
        return reason
    loads = FusedLoads(problem.form)
    if not loads.known or loads.varies:
        return "loads depend on functions of the grid, or on fields that a step changes"
    if sides.incoming:
        return "waves come in through a side"
    if sides.frictional and settings.scheme == "usf":
        return 'frictional sides with scheme="usf"'
    return None


def _why_not_the_form(form: WeakForm) -> str | None:
    """Reason why the fused loops do not support a form, or None."""
    points, declarations = form.points, form.parts.declarations
    space = form.spaces[0]
    if points.gdim == 1:
        return "the loops are for two and three dimensions"
    if space.configuration == "total":
        return "the configuration is total Lagrangian"
    if space.coarsen > 1:
        return "the field has coarser cells than the grid"
    if any(one is not None for one in form.parts.grid.external):
        return "loads over cells or facets of the grid"
    kinds = {formulation_of(d) for d in declarations}
    if len(kinds) != 1 or None in kinds:
        return "laws have several strain formulations, or an unsupported one"
    published = [d for d in declarations if isinstance(d.law, UMAT)]
    if published and len(published) < len(declarations):
        return "some laws are UMATs, and others are not"
    if published and declarations[0].fbar:
        return "F-bar acts on UMATs"
    if published and points.axisymmetric:
        return "UMATs act on axisymmetric points"
    if any(d.fbar for d in declarations) and (len(declarations) > 1 or declarations[0].tags):
        return "F-bar acts in laws by tags"
    if any(d.fbar == VOLUMES for d in declarations):
        return "the points keep the mean volumes of F-bar"
    if any(d.u is not space.increment for d in declarations):
        return "a law has another increment"
    if formulation_of(declarations[0]) == NEO and any(d.law.varies for d in declarations):
        return "the parameters of a neo-Hookean law vary"
    if form.boundaries:
        return "terms over boundaries that do not fit the grid"
    if form.parts.surfaces:
        return "loads on surfaces, which move with the points"
    strange = next((term for term in form.parts.terms if not term.fusable), None)
    if strange is not None:
        return f"the loops do not support the term {strange!r}"
    own = [term for d in declarations for term in d.terms]
    for integral in form.given.integrals():
        if term_of(integral) or any(integral.integrand() is term for term in own):
            continue
        inside = (integral.metadata() or {}).get("points")
        for term in summands(integral.integrand()):
            if inside is None or isinstance(term, Zero):
                # penalties on the increment vanish at zero increments
                continue
            if inside != points.number or depends_on(term, [space.increment]):
                return "terms of the points other than momentum and loads"
            if len(extract_arguments(term)) != 1:
                return "terms without a test function"
    return None


class FusedLoads:
    """Loads of a form as forces at the points.

    Args:
        form: The weak form.

    Attributes:
        uniform: Whether the loads are the same acceleration at all points.
        gravity: This acceleration (m/s²), shape (d,); zeros if loads are not uniform.
        body: Forces on the points (N), shape (n, d), or (0, d) if loads are uniform.
        varies: Whether the loads depend on fields that a step changes.
    """

    uniform: bool
    gravity: Array
    body: Array

    def __init__(self, form: WeakForm):
        self._form, self._revision = form, -1
        programs = [region.external for region in form.regions]
        keys = [key for program in programs if program for key in program.inputs]
        self.known = all(key[0] in ("field", "constant", "tagged") for key in keys)
        self.varies = any(key[0] == "field" and key[1] not in _FIXED for key in keys)
        self._constants = [
            c for region in form.regions for c in region.placeholders.constants if not is_own(c)
        ]
        self._taken = self._values()

    def _values(self) -> list[Array]:
        return [np.array(c.value) for c in self._constants]

    def changed(self) -> bool:
        """Whether constants of the form have changed since the last evaluation."""
        return any(not np.array_equal(a, b) for a, b in zip(self._taken, self._values()))

    def follow(self, touched: Set[str]) -> None:
        """Evaluate the present loads, unless they are unchanged. Collective.

        Args:
            touched: Fields that may have changed since the last evaluation, on any rank.
        """
        still = self._revision == self._form.points.revision and not touched & _OF_LOADS
        if not still or self.changed():
            self.evaluate()

    def evaluate(self) -> None:
        """Evaluate the present loads. Collective."""
        self._taken = self._values()
        points = self._form.points
        self._revision = points.revision
        d, n = points.gdim, len(points)
        forces = np.zeros((n, d))
        for region in self._form.regions:
            chosen = region.chosen(points["tag"])
            # indexing would copy; a slice is a view
            rows: Any = slice(None) if chosen is None else np.flatnonzero(chosen)
            program = region.external
            if program is None:
                continue
            data: dict[tuple, Array] = {}
            for key in program.inputs:
                if key[0] == "field":
                    data[key] = points[key[1]][rows]
                elif key[0] == "tagged":
                    data[key] = np.isin(points["tag"][rows], key[1]).astype(float)
                else:
                    value = region.placeholders.constants[key[1]].value
                    data[key] = np.array(value, float).reshape(1, -1)
            count = n if chosen is None else rows.size
            flux = np.empty((count, program.size))
            program.run(data, flux)
            forces[rows] -= flux.reshape(count, d, 1 + d)[:, :, 0]
        m = point_masses(points)
        # by columns: NumPy's reductions of short rows are ten times slower
        a = [forces[:, k] / m for k in range(d)]
        low = np.array([one.min(initial=np.inf) for one in a])
        high = np.array([one.max(initial=-np.inf) for one in a])
        points.comm.Allreduce(MPI.IN_PLACE, low, op=MPI.MIN)
        points.comm.Allreduce(MPI.IN_PLACE, high, op=MPI.MAX)
        self.uniform = bool(np.all(high - low <= 1e-14 * np.abs(high).max(initial=0.0)))
        if self.uniform:
            self.gravity, self.body = high, np.empty((0, d))
        else:
            self.gravity, self.body = np.zeros(d), forces
