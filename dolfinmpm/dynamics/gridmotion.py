"""Motion of the grid's nodes in implicit steps in time: from the points, and back to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform import stages
from dolfinmpm._platform.errors import SingularMassWarning, warn
from dolfinmpm.assembly.term import NewState
from dolfinmpm.basis.stencils import gather
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.activation import Activation, ActiveField
from dolfinmpm.cut.pattern import Blocks
from dolfinmpm.dynamics.boundarywork import boundary_forces, forces_without_contact, has_walls
from dolfinmpm.dynamics.energybounds import EnergyGain, PenaltyEnergy
from dolfinmpm.dynamics.facesatnodes import Sides
from dolfinmpm.dynamics.inertia import Dashpots, NewmarkRule
from dolfinmpm.dynamics.ledger import Ledger
from dolfinmpm.dynamics.mappings import Mapping, NodalMotion
from dolfinmpm.dynamics.mass import MassTerms, point_masses
from dolfinmpm.dynamics.nodalmass import Mass
from dolfinmpm.dynamics.stepwork import (
    MovingNodes,
    add_work_of_nodes,
    mean_contact_forces,
    work_of_contact,
    work_of_loads,
    work_of_waves,
)
from dolfinmpm.dynamics.transfer import collect, scatter
from dolfinmpm.dynamics.worksums import Work
from dolfinmpm.forms.declarations import rows_within
from dolfinmpm.grid.tensors import inverses
from dolfinmpm.solve.operator import Operator
from dolfinmpm.solve.step import Step
from dolfinmpm.solve.weakform import WeakForm

__all__ = ["GridMotion"]

Array = npt.NDArray[np.float64]
_SINGULAR = (
    "the consistent mass is singular: a body has fewer points than free nodes. From the next step "
    "on it has a ghost penalty, which takes some energy; give a ghost_mass above 0, such as 0.25, "
    'from the start, or mass="lumped", or more points per cell'
)


class GridMotion:
    """Motion of the nodes in the present step, and its transfer from and to the points.

    Args:
        points: Material points.
        rule: The rule of the steps.
        mapping: The velocity mapping.
        terms: The terms of the mass.
        sides: Faces of the grid that act on the body.
        ledger: The account of energies; steps add to its sums.

    Attributes:
        rule, mapping, terms, ledger: The arguments.
        penalty_energy: Energy taken by penalties on changes of velocity.
        nodes: Nodes of each field that moves points, at the start of the last step.
        varying: Whether any load changes in the present step.
        boundary_forces: Forces of boundaries at the start of the step (N), shape
            (nodes, components) per field, or None without boundaries.
    """

    nodes: list[MovingNodes]
    boundary_forces: list[Array] | None = None

    def __init__(
        self,
        points: MaterialPoints,
        rule: NewmarkRule,
        mapping: Mapping,
        terms: MassTerms,
        sides: Sides,
        ledger: Ledger,
    ):
        self.rule, self.mapping, self.terms = rule, mapping, terms
        self._points, self._sides, self.varying = points, sides, False
        self.ledger, self.penalty_energy, self._gain = ledger, PenaltyEnergy(), EnergyGain()
        # whether the accelerations at the start of the next step follow from M a = f
        self._starting = True
        self._step = Step()

    def begin(self, jumped: bool, varying: bool) -> None:
        """Begin a step, after the ledger.

        Points that come have no acceleration yet, and where points go their loads and stresses go:
        the accelerations follow from M a = f, as where a load jumps.

        Args:
            jumped: Whether a load jumps at the start of the step.
            varying: Whether any load changes in the step.
        """
        self.varying = varying
        self._starting |= jumped or self.ledger.came
        self.ledger.came = False

    def regrid(self) -> None:
        """Discard data that depend on the old grid lines; see `regrid`."""
        self._sides.regrid()

    @stages.assemble
    def to_grid(self, here: Activation, form: WeakForm, step: Step, rates: Sequence[Array]) -> None:
        """Velocities and accelerations of the nodes at the start of a step. Collective.

        Args:
            here: The activation.
            form: The weak form, for M a = f.
            step: The step.
            rates: Velocities of prescribed components (m/s), shape (nodes, d) per field.
        """
        start, self._step = None, step
        for k in here.movers:
            self._sides.on(here.fields[k].basis, step, here.fields[k].C)
        self.boundary_forces = None
        if self._starting or self.rule.by_forces or form.has_boundary_forces:
            plain = Operator(form, here)
            plain.move_to_start()
            self.boundary_forces = boundary_forces(plain)
        if self._starting or self.rule.by_forces:
            start = forces_without_contact(plain)
        self.nodes = [
            self._on_nodes(here, k, rates[k], None if start is None else start[k])
            for k in here.movers
        ]
        if self.rule.by_forces and any(one.mass.singular for one in self.nodes):
            self._penalise()
            warn(form.points.comm, _SINGULAR, SingularMassWarning)
        if here.blocks_of("changes"):
            moving = [(one.k, one.mass, one.V) for one in self.nodes]
            share = self._ghost_share * (1 - self.rule.alpha_f)
            self.penalty_energy.begin(here, moving, step.dt, share)

    @property
    def _ghost_share(self) -> float:
        """Share of the forces at the level of balance in a step's mean forces.

        It is γ if accelerations at the start of a step follow from forces.
        """
        return self.rule.gamma if self.rule.by_forces else 1.0

    def _on_nodes(self, here: Activation, k: int, rates: Array, start: Array | None) -> MovingNodes:
        """Motion of the nodes of one field at the start of a step. Collective.

        Args:
            here: The activation.
            k: Number of the field.
            rates: Velocities of prescribed components (m/s), shape (nodes, d).
            start: Out-of-balance force (N), shape (nodes, d), if accelerations follow from forces;
                else None.
        """
        points, field = self._points, here.fields[k]
        mass = Mass(self.terms, here, k=k)
        momenta = mass.nodal()
        x_node = field.basis.node_coordinates()
        self.mapping.to_grid(points, field, x_node, momenta)
        given = momenta.arrays[0].copy()
        fastest = float(np.abs(points["velocity"]).max(initial=0.0))
        V = mass.velocities(momenta, rates, fastest).arrays[0]
        if start is None:
            return MovingNodes(k, field.space.tags, mass, given, V, self._mapped(mass, field))
        forces = mass.nodal()
        forces.arrays[0][:] = -start
        faces = self._sides.on(field.basis)
        if faces is not None and faces.dashpots is not None:
            forces.arrays[0][:] -= faces.dashpots * V
            if faces.incoming:
                forces.arrays[0][:] += faces.wave_forces(self._step.start)
        A: Array = mass.solve(forces, np.zeros_like(V)).arrays[0]
        if mass.singular and self.rule.by_forces:
            # forces along vectors without mass accelerate nothing, and steps from them make energy
            if self._starting:
                A = np.where(here.unknowns.fields[k].fixed, 0.0, mass.own_velocities(forces))
            else:
                A = self._mapped(mass, field)
        return MovingNodes(k, field.space.tags, mass, given, V, A)

    def _penalise(self, densities: Sequence[float] = ()) -> None:
        """Give a singular mass its ghost penalty from the next step on. Collective."""
        self.rule = replace(self.rule, by_forces=False)
        self.terms.penalise(densities=densities)

    def _mapped(self, mass: Mass, field: ActiveField) -> Array:
        """Accelerations of nodes (m/s²) from those of points, shape (nodes, d). Collective."""
        points, forces = self._points, mass.nodal()
        scatter(field.stencils, point_masses(points), points["acceleration"], forces.arrays[0])
        forces.add_up()
        return mass.solve(forces, np.zeros_like(forces.arrays[0])).arrays[0]

    def dashpots(self, here: Activation) -> Dashpots | None:
        """Dashpots of absorbing faces at the level of balance, or None. Collective."""
        faces = self._sides.on(here.fields[0].basis)
        if faces is None or faces.dashpots is None:
            return None
        rule, d, c, dt = self.rule, self._points.gdim, faces.dashpots, self._step.dt
        level, one = 1.0 - rule.alpha_f, self.nodes[0]
        rest = rule.acceleration(np.zeros_like(one.V), one.V, one.A, dt)
        start = level * rule.velocity(one.V, one.A, rest, dt) + rule.alpha_f * one.V
        push = c * start
        if faces.incoming:
            push = push - faces.wave_forces(self._step.start + level * dt)
        owned = here.unknowns.fields[0].owned_nodes
        nodes = owned[c[owned].any(axis=1)]
        values = rule.gamma / (rule.beta * dt) * c[nodes][:, :, None] * np.eye(d)
        return Dashpots(Blocks(0, 0, nodes, nodes, values), push, owned)

    @stages.commit
    def end(self, operator: Operator) -> None:
        """Find the motion of the nodes at the end of the step. Collective.

        Args:
            operator: The step's equations, with the increments at the end of the step.
        """
        rule, dt = self.rule, self._step.dt
        for one in self.nodes:
            u = operator.increments[one.k]
            A_end = rule.acceleration(u, one.V, one.A, dt)
            V_end = rule.velocity(one.V, one.A, A_end, dt)
            push = None
            if _touches(operator):
                push = self._push(one, operator)
                V_end, A_end = rule.with_contact(V_end, A_end, push, dt)
            one.motion = NodalMotion(one.V, one.A, V_end, A_end, u, push)

    @stages.commit
    def to_points(
        self,
        operator: Operator,
        state: NewState,
        x: Array,
        scale: float,
        may_halve: bool,
        on_boundaries: float,
    ) -> str | None:
        """Add the points' new motion to a new state, after `end`. Collective.

        Loads must have their values in the middle of the step, for their work.

        Args:
            operator: The step's equations, with the increments at the end of the step.
            state: The new state; the new motion is added to it.
            x: Unknowns at the level of balance, shape (owned,).
            scale: Increments at the end over increments at the level of balance.
            may_halve: Whether a step that makes energy may be halved.
            on_boundaries: Work of the forces on boundaries (J).

        Returns:
            The reason to halve the step, or None.
        """
        points, step = self._points, self._step
        found = [self._from_nodes(one, operator) for one in self.nodes]
        kept = self.mapping.kept_share
        loads = work_of_loads(operator, x, scale, self.nodes, step.dt, self.varying, kept)
        work = Work(external=loads + on_boundaries)
        stored: dict[int, float] = {}
        work.add_stresses(points, state.fields, operator)
        for one in self.nodes:
            expected = self.penalty_energy.share[one.k] * step.dt * one.V
            share = self._ghost_share / scale
            faces = self._sides.on(operator.here.fields[one.k].basis)
            stored[one.k] = add_work_of_nodes(work, one, operator, share, expected, faces)
            if faces is not None and faces.incoming:
                work.external += work_of_waves(faces, step, one, operator)
        # with a lumped mass, the mapping changes energy more than the rule does
        if _touches(operator) and self.terms.kind == "consistent":
            contact = work_of_contact(operator, self.nodes)
            reason = self._gain.judge(work, contact, self.ledger.whole, may_halve)
            if reason is not None:
                return reason
        self.ledger.work.add(work)
        for k, taken in stored.items():
            self.penalty_energy.energy[k] += taken
        new = found[0]
        for one, own in zip(self.nodes[1:], found[1:]):
            rows = rows_within(points, one.tags)
            for name, values in own.items():
                new[name][rows] = values[rows]
        state.fields.update(new)
        self._starting = False
        return None

    def _push(self, one: MovingNodes, operator: Operator) -> Array:
        """Mean accelerations of the nodes of a field by contact (m/s²). Collective."""
        forces = one.mass.nodal()
        forces.arrays[0][:] = mean_contact_forces(operator)[one.k]
        push = one.mass.solve(forces, np.zeros_like(one.V)).arrays[0]
        one.held = one.mass.times(push).arrays[0] - forces.arrays[0]
        return push

    def excess_of_supports(self, operator: Operator) -> Array:
        """Part of the holding forces by which contact counts more than once. Collective.

        The equations contain the mean forces of contact with a weight, which the accelerations do
        not keep; see `NewmarkRule.with_contact`.

        Args:
            operator: The step's equations, after `end`.

        Returns:
            Forces (N) in the order of `Operator.holding_forces`.
        """
        unknowns, means = operator.here.unknowns, operator.form.contact_weights
        found = unknowns.nodal().arrays
        for one in self.nodes:
            if one.held is not None:
                assert means is not None
                found[one.k][:] = (means.weight - 1.0) * one.held
        return unknowns.reactions(found)

    def _from_nodes(self, one: MovingNodes, operator: Operator) -> dict[str, Array]:
        """New motion of the points of a field. Rows of other points have no meaning. Collective."""
        points, field = self._points, operator.here.fields[one.k]
        s, x_node = field.stencils, field.basis.node_coordinates()
        if self._starting and self.mapping.kind == "accel":
            rows = rows_within(points, one.tags)
            points["acceleration"][rows] = collect(s, one.A)[rows]
        gradient = np.zeros((len(points), points.gdim, points.gdim))
        if self.mapping.kind == "tpic":
            gather(s, one.motion.V_end, np.empty((len(points), points.gdim)), gradient)
            dF = np.eye(points.gdim) + operator.points.gradient[one.k]
            gradient = gradient @ inverses(dF)
        return self.mapping.to_points(
            points, field, x_node, one.motion, one.mass, self._step.dt, self.rule.gamma, gradient
        )

    def errors(self, here: Activation) -> Array:
        """Error |β − 1/6| Δt² |a' − a| of a step's displacement, and its size (m). Collective.

        Zienkiewicz & Xie 1991, doi 10.1002/eqe.4290200907.
        """
        both: Array = np.zeros(2)
        for one in self.nodes:
            nodes, motion = here.fields[one.k].nodes, one.motion
            assert motion.u is not None
            change = np.abs(motion.A_end[nodes] - motion.A[nodes]).max(initial=0.0)
            both = np.maximum(both, [change, np.abs(motion.u[nodes]).max(initial=0.0)])
        self._points.comm.Allreduce(MPI.IN_PLACE, both, op=MPI.MAX)
        both[0] *= abs(self.rule.beta - 1 / 6) * self._step.dt**2
        return both

    def state(self) -> dict[str, Any]:
        """Its state from step to step."""
        return {
            "starting": int(self._starting or self.ledger.came),
            "by_forces": int(self.rule.by_forces),
            "ghost_densities": self.terms.densities,
            "reserve": sorted(self.penalty_energy.energy.items()),
            "gained": self._gain.made,
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Restore a state returned by `state`."""
        self._starting, self.ledger.came = bool(state["starting"]), False
        if self.rule.by_forces and not state["by_forces"]:
            self._penalise(state.get("ghost_densities", ()))
        elif state["by_forces"] and self.terms.densities:
            # this problem found its mass singular after the state was saved
            self.rule = replace(self.rule, by_forces=True)
            self.terms.release()
        self.penalty_energy.energy.clear()
        self.penalty_energy.energy.update({int(k): energy for k, energy in state["reserve"]})
        self._gain.made = state["gained"]


def _touches(operator: Operator) -> bool:
    """Whether forces of contact act in the mean over a step."""
    return operator.has("contact") or has_walls(operator)
