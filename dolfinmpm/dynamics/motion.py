"""The motion of the nodes in a step in time, from the points and back to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from mpi4py import MPI

from dolfinmpm._platform import stages
from dolfinmpm._platform.checks import Tags
from dolfinmpm.basis.stencils import gather
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.participants import Activation
from dolfinmpm.cut.pattern import Blocks
from dolfinmpm.dynamics.faces import Sides
from dolfinmpm.dynamics.ledger import Ledger
from dolfinmpm.dynamics.mappings import Mapping, NodalMotion
from dolfinmpm.dynamics.mass import Mass, MassTerms, point_masses
from dolfinmpm.dynamics.transfer import collect, scatter
from dolfinmpm.forms.declarations import rows_within
from dolfinmpm.solve.advance import NewState
from dolfinmpm.solve.operator import Operator
from dolfinmpm.solve.step import Step
from dolfinmpm.solve.weakform import WeakForm

__all__ = ["Motion", "Rule"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Rule:
    """Parameters of a rule of Newmark's family, with α_m = α_f = 0 Newmark's own.

    Attributes:
        beta, gamma, alpha_m, alpha_f: See `dolfinmpm.dynamics.newmark`.
        by_forces: Whether each step begins with the accelerations that the forces give, M a = f.
            Else these are means of those that the points have from the last step, which have lost
            what does not vary smoothly, and energy with it.
    """

    beta: float
    gamma: float
    alpha_m: float = 0.0
    alpha_f: float = 0.0
    by_forces: bool = False

    def acceleration(self, u: Array, V: Array, A: Array, dt: float) -> Array:
        """a' at the nodes (m/s²)."""
        return (u - dt * V) / (self.beta * dt**2) - (0.5 / self.beta - 1.0) * A

    def velocity(self, V: Array, A: Array, A_end: Array, dt: float) -> Array:
        """v' at the nodes (m/s)."""
        return V + dt * ((1 - self.gamma) * A + self.gamma * A_end)

    def pushed(self, V_end: Array, A_end: Array, push: Array, dt: float) -> tuple[Array, Array]:
        """v' and a' where contact has pushed besides, by its mean accelerations (m/s²).

        Its impulse is that of the whole step, and accelerations go on without it.

        Args:
            V_end, A_end: Those that `velocity` and `acceleration` give of the increment.
            push: M⁻¹ times the mean forces.
            dt: Length of the step (s).
        """
        V_end = V_end + dt * (1.0 - 0.5 * self.gamma / self.beta) * push
        return V_end, A_end - 0.5 / self.beta * push

    def known(self, V: Array, A: Array, dt: float) -> Array:
        """What of the accelerations at the level of balance does not depend on the increment."""
        start = V / (self.beta * dt) + (0.5 / self.beta - 1.0) * A
        return self.alpha_m * A - (1 - self.alpha_m) * start

    def factor(self, dt: float) -> float:
        """Its derivative by the increment at that level (1/s²)."""
        return (1 - self.alpha_m) / (self.beta * dt**2 * (1 - self.alpha_f))


@dataclass
class MovingNodes:
    """The nodes of a field that moves points, at the start of a step.

    Attributes:
        k: Number of the field.
        tags: Tags of the points that it moves, or None for all.
        mass: Their mass.
        momenta: Momenta that the points gave them (kg m/s), shape (nodes, d).
        V, A: Their velocities (m/s) and accelerations (m/s²), likewise.
    """

    k: int
    tags: Tags
    mass: Mass
    momenta: Array
    V: Array
    A: Array


class Motion:
    """What moves, and how it moved last.

    Args:
        points: Material points.
        rule: The rule of the steps.
        mapping: The velocity mapping.
        terms: What the mass is made of.
        error: Bound of a step's error, see `Newmark`, or None.
        clock: DOLFINx constant that holds the time (s), or None.
        sides: Faces of the grid that act on the body.
        ledger: Where energy comes from and goes to; steps add to its sums.

    Attributes:
        rule, mapping, terms, ledger: The arguments.
        nodes: What moved in the last step: the nodes of each field that moves points.
        start, end: Times between which the step asked for goes (s).
        jumped, varying: Whether a load jumps at its start, and whether any changes in it.
        time: Time that the state is of (s).
        last, wanted: Length of the last part of a step, and of the next where it is free (s).
    """

    nodes: list[MovingNodes]

    def __init__(
        self,
        points: MaterialPoints,
        rule: Rule,
        mapping: Mapping,
        terms: MassTerms,
        error: float | None,
        clock: fem.Constant | None,
        sides: Sides,
        ledger: Ledger,
    ):
        self.rule, self.mapping, self.terms = rule, mapping, terms
        self._points, self._error, self._clock = points, error, clock
        self._sides = sides
        self.time = self.start = self.end = 0.0
        self.last = self.wanted = 0.0
        self.jumped = self.varying = False
        self.ledger = ledger
        # whether the next step begins with M a = f
        self._starting = True
        self._largest = 0.0

    @property
    def chooses(self) -> bool:
        """Whether the lengths of steps may follow from their errors."""
        return self._error is not None

    def begin(self, end: float, jumped: bool, varying: bool) -> None:
        """Begin a step to a time (s), in which a load jumps, or any changes."""
        self.start, self.end, self.jumped = self.time, end, jumped
        self.varying = varying or self._clock is not None
        self._starting |= jumped

    def regrid(self) -> None:
        """Forget what belongs to where the grid's lines were; see `regrid`."""
        if self.terms.ghost is not None:
            self.terms.ghost.regrid()
        self._sides.regrid()

    def set_time(self, t: float) -> None:
        """Tell the form the time (s)."""
        if self._clock is not None:
            self._clock.value = t

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
            plain.start()
            start = plain.forces(contacts=False)
        self.nodes = [
            self._on_nodes(here, k, rates[k], None if start is None else start[k])
            for k in here.movers
        ]

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

    def dashpots(self, here: Activation, dt: float) -> tuple[Blocks, Array] | None:
        """Dashpots of absorbing faces at the level where forces balance. Collective.

        Returns:
            Their derivative by the increments, this rank's nodes, and the forces of velocities
            without increments (N), shape (nodes, d), at the nodes' owners; or None.
        """
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
        return Blocks(0, 0, nodes, nodes, values), c * start

    @stages.commit
    def to_points(
        self, operator: Operator, state: NewState, step: Step, x: Array, scale: float
    ) -> str | None:
        """Add the points' new motion to a new state. Collective.

        The loads are those in the middle of the step, for their work.

        Args:
            operator: The step's equations, moved to the end of the step.
            state: The new state, which is added to.
            step: The step.
            x: Unknowns at the level where forces balance, shape (owned,).
            scale: What they are multiplied by at the end.

        Returns:
            Why the step is not to be taken, or None.
        """
        points, here, dt, rule = self._points, operator.here, step.dt, self.rule
        motions = []
        for one in self.nodes:
            u = operator.increments[one.k]
            A_end = rule.acceleration(u, one.V, one.A, dt)
            V_end = rule.velocity(one.V, one.A, A_end, dt)
            push = None
            if operator.touches:
                push = self._push(one, operator)
                V_end, A_end = rule.pushed(V_end, A_end, push, dt)
            motions.append(NodalMotion(one.V, one.A, V_end, A_end, u, push))
        reason = self._judge(motions, here, dt)
        if reason is not None:
            return reason
        found = [self._from_nodes(*both, operator, dt) for both in zip(self.nodes, motions)]
        external = self._external(operator, x, scale, motions, dt)
        self.ledger.work.external += external
        self.ledger.work.add_stresses(points, state.fields, operator)
        for one, motion in zip(self.nodes, motions):
            self._count(one, motion, operator, dt, scale)
        new = found[0]
        for one, own in zip(self.nodes[1:], found[1:]):
            rows = rows_within(points, one.tags)
            for name, values in own.items():
                new[name][rows] = values[rows]
        state.fields.update(new)
        self._starting = False
        self.time, self.last = step.t, dt
        return None

    def _push(self, one: MovingNodes, operator: Operator) -> Array:
        """Accelerations of the nodes of a field by mean forces of contact (m/s²). Collective."""
        forces = one.mass.nodal()
        forces.arrays[0][:] = self._pressed(operator)[one.k]
        return one.mass.solve(forces, np.zeros_like(one.V)).arrays[0]

    @staticmethod
    def _pressed(operator: Operator) -> list[Array]:
        """Mean forces of contact on the nodes of each field (N). Collective."""
        means = operator.form.means
        assert means is not None
        out = [np.zeros_like(u) for u in operator.increments]
        operator.contact_forces(out)
        return [np.asarray(-force / means.weight) for force in out]

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

    def _external(
        self,
        operator: Operator,
        x: Array,
        scale: float,
        motions: Sequence[NodalMotion],
        dt: float,
    ) -> float:
        """Work of loads, and of what moves prescribed components, in a step (J). Collective.

        What moves them gives the nodes momentum, and the body forces that are the mean of those
        before and after, at the velocity u/Δt: the work is of second order.
        """
        here = operator.here
        if not (here.driven or self.varying):
            return operator.load_work()
        plain = Operator(operator.form, here)
        if not here.driven:
            plain.move(x, scale)
            return plain.load_work()
        plain.start()
        start = plain.forces(contacts=False)
        plain.move(x, scale)
        both = zip(start, plain.forces(contacts=False), self._pressed(operator))
        forces = [0.5 * (f + g) - pressed for f, g, pressed in both]
        for one, motion in zip(self.nodes, motions):
            forces[one.k] += (one.mass.times(motion.V_end).arrays[0] - one.momenta) / dt
        return plain.load_work() + plain.held_work(forces)

    def _count(
        self, one: MovingNodes, motion: NodalMotion, operator: Operator, dt: float, scale: float
    ) -> None:
        """Add what the nodes' kinetic energy changes by, and what penalties and dashpots take.

        Collective. Of the forces at the end of a step a share γ acts in it, where it begins with
        accelerations of its own.
        """
        mass, losses, here = one.mass, self.ledger.work.losses, operator.here
        found = [mass.kinetic(V) for V in (motion.V, motion.V_end)]
        self.ledger.work.grid += found[1][0] - found[0][0]
        losses["ghost mass"] += found[1][1] - found[0][1]
        u = motion.u
        assert u is not None
        share = self.rule.gamma if self.rule.by_forces else 1.0
        expected = dt * one.V
        plain = [b for b in operator.penalties if b.row_field == b.column_field == one.k]
        changes = [b for b in here.changes if b.row_field == one.k]
        taken = mass.inner(u, plain, u) / scale + mass.inner(u, changes, u - expected) / scale
        losses["ghost stiffness"] += share * taken
        faces = self._sides.on(here.fields[one.k].basis)
        if faces is not None and faces.dashpots is not None:
            owned = here.unknowns.fields[one.k].owned_nodes
            mean = 0.5 * (motion.V + motion.V_end)
            done = float(np.sum((faces.dashpots * mean * u)[owned]))
            losses["damping"] += mass.comm.allreduce(done, op=MPI.SUM)

    def _judge(self, motions: Sequence[NodalMotion], here: Activation, dt: float) -> str | None:
        """Bound the error |β − 1/6| Δt² |a' − a| of a step's displacement. Collective.

        Zienkiewicz & Xie 1991, doi 10.1002/eqe.4290200907.
        """
        if self._error is None:
            return None
        both: Array = np.zeros(2)
        for one, motion in zip(self.nodes, motions):
            nodes = here.fields[one.k].nodes
            assert motion.u is not None
            change = np.abs(motion.A_end[nodes] - motion.A[nodes]).max(initial=0.0)
            both = np.maximum(both, [change, np.abs(motion.u[nodes]).max(initial=0.0)])
        self._points.comm.Allreduce(MPI.IN_PLACE, both, op=MPI.MAX)
        found = abs(self.rule.beta - 1 / 6) * dt**2 * both[0]
        allowed = self._error * max(self._largest, both[1])
        ratio = (allowed / found) ** (1 / 3) if found > 0 else 2.0
        self.wanted = dt * min(max(0.9 * ratio, 0.2), 2.0)
        if found > allowed:
            return (
                f"the error of the step's displacement is {found:.3g} m and may be {allowed:.3g} m"
            )
        self._largest = max(self._largest, both[1])
        return None

    def memory(self) -> dict[str, Any]:
        """What a checkpoint keeps."""
        return {
            "time": self.time,
            "last part": self.last,
            "wanted part": self.wanted,
            "starting": int(self._starting),
            "largest": self._largest,
        }

    def remember(self, state: dict[str, Any]) -> None:
        """Take what `memory` returned."""
        self.time, self.last = state["time"], state["last part"]
        self.wanted, self._largest = state["wanted part"], state["largest"]
        self._starting = bool(state["starting"])
        self.set_time(self.time)
