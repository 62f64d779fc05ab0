"""The motion of the nodes in a step in time, from the points and back to them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform import stages
from dolfinmpm.assembly.term import NewState
from dolfinmpm.basis.stencils import gather
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.participants import Activation
from dolfinmpm.cut.pattern import Blocks
from dolfinmpm.dynamics.faces import Sides
from dolfinmpm.dynamics.gains import Gains
from dolfinmpm.dynamics.inertiaterm import Dashpots
from dolfinmpm.dynamics.ledger import Ledger, Work
from dolfinmpm.dynamics.mappings import Mapping, NodalMotion
from dolfinmpm.dynamics.mass import Mass, MassTerms, point_masses
from dolfinmpm.dynamics.reserve import Reserve
from dolfinmpm.dynamics.rule import Rule
from dolfinmpm.dynamics.stepwork import (
    MovingNodes,
    count,
    pressed,
    work_of_contact,
    work_of_loads,
)
from dolfinmpm.dynamics.transfer import collect, scatter
from dolfinmpm.forms.declarations import rows_within
from dolfinmpm.solve.operator import Operator
from dolfinmpm.solve.weakform import WeakForm

__all__ = ["Motion"]

Array = npt.NDArray[np.float64]


class Motion:
    """What moves, and how it moved last.

    Args:
        points: Material points.
        rule: The rule of the steps.
        mapping: The velocity mapping.
        terms: What the mass is made of.
        sides: Faces of the grid that act on the body.
        ledger: Where energy comes from and goes to; steps add to its sums.

    Attributes:
        rule, mapping, terms, ledger: The arguments.
        reserve: What penalties on changes of velocity may give back.
        nodes: What moved in the last step: the nodes of each field that moves points.
        varying: Whether any load changes in the step asked for.
    """

    nodes: list[MovingNodes]

    def __init__(
        self,
        points: MaterialPoints,
        rule: Rule,
        mapping: Mapping,
        terms: MassTerms,
        sides: Sides,
        ledger: Ledger,
    ):
        self.rule, self.mapping, self.terms = rule, mapping, terms
        self._points, self._sides, self.varying = points, sides, False
        self.ledger, self.reserve, self._gains = ledger, Reserve(), Gains()
        # whether the next step begins with M a = f
        self._starting = True

    def begin(self, jumped: bool, varying: bool) -> None:
        """Begin a step at whose start a load jumps, or in which any changes."""
        self.varying = varying
        self._starting |= jumped

    def regrid(self) -> None:
        """Forget what belongs to where the grid's lines were; see `regrid`."""
        self._sides.regrid()

    @stages.assemble
    def to_grid(self, here: Activation, form: WeakForm, dt: float, rates: Sequence[Array]) -> None:
        """Velocities and accelerations of the nodes at the start of a step. Collective.

        Args:
            here: What is active.
            form: The weak form, for M a = f.
            dt: Length of the step (s).
            rates: Velocities of held components (m/s), (nodes, d) for each field.
        """
        start = None
        if self._starting or self.rule.by_forces:
            plain = Operator(form, here)
            plain.move_to_start()
            start = plain.forces(without=("contact",))
        self.nodes = [
            self._on_nodes(here, k, rates[k], None if start is None else start[k])
            for k in here.movers
        ]
        if here.blocks_of("changes"):
            moving = [(one.k, one.mass, one.V) for one in self.nodes]
            self.reserve.begin(here, moving, dt, self._ghost_share * (1 - self.rule.alpha_f))

    @property
    def _ghost_share(self) -> float:
        """Share of forces at the level of balance in a step's mean forces.

        Where steps begin with accelerations of their own it is γ.
        """
        return self.rule.gamma if self.rule.by_forces else 1.0

    def _on_nodes(self, here: Activation, k: int, rates: Array, start: Array | None) -> MovingNodes:
        """Those of one field; `start` is what is out of balance (N) if it begins. Collective."""
        points, field = self._points, here.fields[k]
        mass = Mass(self.terms, here, k=k)
        momenta = mass.nodal()
        x_node = field.basis.node_coordinates()
        self.mapping.to_grid(points, field.stencils, x_node, momenta)
        given = momenta.arrays[0].copy()
        fastest = float(np.abs(points["velocity"]).max(initial=0.0))
        V = mass.velocities(momenta, rates, fastest).arrays[0]
        forces = mass.nodal()
        if start is not None:
            forces.arrays[0][:] = -start
            faces = self._sides.on(field.basis)
            if faces is not None and faces.dashpots is not None:
                forces.arrays[0][:] -= faces.dashpots * V
        else:
            m = point_masses(points)
            scatter(field.stencils, m, points["acceleration"], forces.arrays[0])
            forces.add_up()
        A = mass.solve(forces, np.zeros_like(V)).arrays[0]
        return MovingNodes(k, field.space.tags, mass, given, V, A)

    def dashpots(self, here: Activation, dt: float) -> Dashpots | None:
        """Dashpots of absorbing faces at the level where forces balance, or None. Collective."""
        faces = self._sides.on(here.fields[0].basis)
        if faces is None or faces.dashpots is None:
            return None
        rule, d, c = self.rule, self._points.gdim, faces.dashpots
        level, one = 1.0 - rule.alpha_f, self.nodes[0]
        rest = rule.acceleration(np.zeros_like(one.V), one.V, one.A, dt)
        start = level * rule.velocity(one.V, one.A, rest, dt) + rule.alpha_f * one.V
        owned = here.unknowns.fields[0].owned_nodes
        nodes = owned[c[owned].any(axis=1)]
        values = rule.gamma / (rule.beta * dt) * c[nodes][:, :, None] * np.eye(d)
        return Dashpots(Blocks(0, 0, nodes, nodes, values), c * start, owned)

    @stages.commit
    def ends(self, operator: Operator, dt: float) -> list[NodalMotion]:
        """How the nodes have moved at the end of a step of that length (s). Collective.

        Args:
            operator: The step's equations, moved to the end of the step.
            dt: Its length (s).
        """
        rule, motions = self.rule, []
        for one in self.nodes:
            u = operator.increments[one.k]
            A_end = rule.acceleration(u, one.V, one.A, dt)
            V_end = rule.velocity(one.V, one.A, A_end, dt)
            push = None
            if operator.has("contact"):
                push = self._push(one, operator)
                V_end, A_end = rule.pushed(V_end, A_end, push, dt)
            motions.append(NodalMotion(one.V, one.A, V_end, A_end, u, push))
        return motions

    @stages.commit
    def to_points(
        self,
        operator: Operator,
        state: NewState,
        motions: Sequence[NodalMotion],
        dt: float,
        x: Array,
        scale: float,
        parts: bool,
    ) -> str | None:
        """Add the points' new motion to a new state. Collective.

        The loads are those in the middle of the step, for their work.

        Args:
            operator: The step's equations, moved to the end of the step.
            state: The new state, which is added to.
            motions: See `ends`.
            dt: Length of the step (s).
            x: Unknowns at the level where forces balance, shape (owned,).
            scale: What they are multiplied by at the end.
            parts: Whether a step that makes energy may be parted.

        Returns:
            Why the step is not to be taken, or None.
        """
        points = self._points
        found = [self._from_nodes(*both, operator, dt) for both in zip(self.nodes, motions)]
        moved, varying = list(zip(self.nodes, motions)), self.varying
        work = Work(external=work_of_loads(operator, x, scale, moved, dt, varying))
        stored: dict[int, float] = {}
        work.add_stresses(points, state.fields, operator)
        for one, motion in moved:
            share, expected = self._ghost_share / scale, self.reserve.share[one.k] * dt * one.V
            faces = self._sides.on(operator.here.fields[one.k].basis)
            stored[one.k] = count(work, one, motion, operator, share, expected, faces)
        # with a lumped mass the mapping makes and takes more than the rule of the steps
        if operator.has("contact") and self.terms.kind == "consistent":
            reason = self._gains.judge(
                work, work_of_contact(operator, self.nodes), self.ledger.whole, parts
            )
            if reason is not None:
                return reason
        self.ledger.work.add(work)
        for k, taken in stored.items():
            self.reserve.energy[k] += taken
        new = found[0]
        for one, own in zip(self.nodes[1:], found[1:]):
            rows = rows_within(points, one.tags)
            for name, values in own.items():
                new[name][rows] = values[rows]
        state.fields.update(new)
        self._starting = False
        return None

    def _push(self, one: MovingNodes, operator: Operator) -> Array:
        """Accelerations of the nodes of a field by mean forces of contact (m/s²). Collective."""
        forces = one.mass.nodal()
        forces.arrays[0][:] = pressed(operator)[one.k]
        return one.mass.solve(forces, np.zeros_like(one.V)).arrays[0]

    def _from_nodes(
        self, one: MovingNodes, motion: NodalMotion, operator: Operator, dt: float
    ) -> dict[str, Array]:
        """The new motion of the points of a field; that of others means nothing. Collective."""
        points, field = self._points, operator.here.fields[one.k]
        s, x_node = field.stencils, field.basis.node_coordinates()
        if self._starting and self.mapping.kind == "accel":
            rows = rows_within(points, one.tags)
            points["acceleration"][rows] = collect(s, one.A)[rows]
        gradient = np.zeros((len(points), points.gdim, points.gdim))
        if self.mapping.kind == "tpic":
            gather(s, motion.V_end, np.empty((len(points), points.gdim)), gradient)
            dF = np.eye(points.gdim) + operator.points.gradient[one.k]
            gradient = gradient @ np.linalg.inv(dF)
        return self.mapping.to_points(
            points, s, x_node, motion, one.mass, dt, self.rule.gamma, gradient
        )

    def errors(self, motions: Sequence[NodalMotion], here: Activation, dt: float) -> Array:
        """Error |β − 1/6| Δt² |a' − a| of a step's displacement, and this (m). Collective.

        Zienkiewicz & Xie 1991, doi 10.1002/eqe.4290200907.
        """
        both: Array = np.zeros(2)
        for one, motion in zip(self.nodes, motions):
            nodes = here.fields[one.k].nodes
            assert motion.u is not None
            change = np.abs(motion.A_end[nodes] - motion.A[nodes]).max(initial=0.0)
            both = np.maximum(both, [change, np.abs(motion.u[nodes]).max(initial=0.0)])
        self._points.comm.Allreduce(MPI.IN_PLACE, both, op=MPI.MAX)
        both[0] *= abs(self.rule.beta - 1 / 6) * dt**2
        return both

    def state(self) -> dict[str, Any]:
        """What it keeps from step to step."""
        return {
            "starting": int(self._starting),
            "reserve": sorted(self.reserve.energy.items()),
            "gained": self._gains.made,
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Take what `state` returned."""
        self._starting = bool(state["starting"])
        self.reserve.energy.clear()
        self.reserve.energy.update({int(k): energy for k, energy in state["reserve"]})
        self._gains.made = state["gained"]
