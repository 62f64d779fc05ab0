"""Explicit steps of colliding bodies. Each body has its own velocities at the nodes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform import stages
from dolfinmpm._platform.errors import FormError, ParameterError, raise_together
from dolfinmpm.basis import LatticeBasis
from dolfinmpm.basis.bspline import integrals
from dolfinmpm.basis.stencils import Stencils, selected
from dolfinmpm.body.loadbalance import balance
from dolfinmpm.cut.activation import Activation
from dolfinmpm.cut.unknowns import Nodal
from dolfinmpm.dynamics.collision import BodiesAtSides, BodyAtNodes, Collision, NodalContact
from dolfinmpm.dynamics.energies import half_step, mapping_loss, stress_volumes
from dolfinmpm.dynamics.explicitbase import ExplicitBase, ExplicitStep, Settings
from dolfinmpm.dynamics.facesatnodes import Sides
from dolfinmpm.dynamics.fusable import FusedLoads
from dolfinmpm.dynamics.mass import point_masses
from dolfinmpm.dynamics.transfer import collect, scatter, scatter_stress, scatter_tensor
from dolfinmpm.solve.method import only_momentum
from dolfinmpm.solve.newstate import commit, new_state
from dolfinmpm.solve.operator import Operator
from dolfinmpm.solve.problem import Problem

__all__ = ["CollisionSteps", "collision_error"]

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.bool_]

# Passes by mapped velocities per step; with 5 passes, coarse bodies gain up to 12 % of their energy
_PASSES = 20


def collision_error(problem: Problem, mass: str, settings: Settings) -> Exception | None:
    """The error about a problem that `Collision` does not support, or None."""
    field, parts = problem.fields[0], problem.form.parts
    if not isinstance(field.space.basis, LatticeBasis):
        return ParameterError("Collision asks for room at the nodes; take a rectangular grid")
    if problem.points.axisymmetric:
        return ParameterError("Collision is of plane and 3D bodies, and these are axisymmetric")
    if mass != "lumped" or settings.mapping.kind not in ("flip", "pic"):
        return ParameterError(
            f'mass = "{mass}" and mapping = "{settings.mapping.kind}" do not go with Collision: '
            'give mass="lumped" and mapping="flip" or "pic"'
        )
    if settings.scheme == "usf" or not settings.plain or field.constrains_nodes or field.prolongate:
        return ParameterError(
            'Collision goes with scheme="musl" or "usl", without bulk viscosity, filters of light '
            "nodes, or stabilisations that tie nodes"
        )
    if problem.bodies.contacts or any(d.fbar for d in parts.declarations):
        return FormError("Collision goes neither with rigid bodies nor with F-bar; leave these out")
    if problem.form.boundaries:
        return FormError(
            f"the form has terms over {problem.form.boundaries[0].boundary}, and Collision has "
            "no single field of velocities there; leave out these terms or collision"
        )
    if not only_momentum(problem.form):
        return FormError(
            "Collision goes with no internal forces but those of mpm.momentum; leave others out"
        )
    if not FusedLoads(problem.form).known or any(one is not None for one in parts.grid.external):
        return FormError(
            "Collision needs loads on the points, of their fields and constants alone, such as "
            "F -= ufl.inner(points.density * g, v) * points.dX"
        )
    return None


class CollisionSteps(ExplicitBase):
    """Explicit steps of a problem with colliding bodies, one after the other.

    Args:
        problem, settings, sides: See `ExplicitBase`.
        collision: The bodies, and their friction.

    Attributes:
        force: Mean force of the other bodies on the first body in the last step (N), shape (d,).
    """

    def __init__(self, problem: Problem, settings: Settings, sides: Sides, collision: Collision):
        super().__init__(problem, settings, sides, "bodies collide")
        self._collision, self._loads = collision, FusedLoads(problem.form)
        self.force: Array = np.zeros(problem.points.gdim)
        self._counted = False

    @stages.commit
    def _take(self, step: ExplicitStep) -> int | str:
        """Take one step; see `ExplicitBase`. Collective."""
        problem, damping = self._problem, self._settings.damping
        points, dt, kick = problem.points, step.dt, step.kick
        raise_together(points.comm, points.error_in_fields())
        balance(points)
        here = problem.activate(step)
        self._loads.evaluate()
        rows = self._collision.bodies(points["tag"])
        raise_together(points.comm, self._strays(rows))
        several = SeveralBodies(problem, rows, here, self._settings)
        bodies = several.at_nodes
        prescribed: Array = np.asarray(here.prescribed[0] / dt, np.float64)
        faces = self.sides.on(here.fields[0].basis, step)
        sides = BodiesAtSides(faces, bodies, here, prescribed, kick, self.kinks)
        before = several.velocities(points["velocity"], sides)
        forces = several.forces(self._loads)
        damped = [damping * np.abs(f) * np.sign(V) for f, V in zip(forces, before)]
        after = [
            V + kick * (f - g) / body.divisor
            for body, V, f, g in zip(bodies, before, forces, damped)
        ]
        pushed = [V_end - V for V, V_end in zip(before, after)]
        sides.absorb(before, after)
        external = sides.stop(after)
        touching = self._touching(bodies, here)
        touching.exchange(after)
        external += sides.stop(after)
        if step.begins:
            self._work.start += several.energy_of_start(pushed, before, after)
        new = several.to_points(before, after, kick)
        strains = after
        if self._settings.scheme == "musl":
            strains = several.velocities(new["velocity"], sides, ends=True)
            if points.comm.allreduce(touching.nodes.any(), op=MPI.LOR):
                several.exchange_mapped(touching, after, strains)
                external += sides.stop(after)
                new = several.to_points(before, after, kick)
                strains = several.velocities(new["velocity"], sides, ends=True)
        operator = Operator(problem.form, here)
        several.place(operator, [dt * V for V in strains])
        moved = points["x"] + operator.points.value[0]
        state = new_state(problem, operator, x=moved)
        if isinstance(state, str):
            return state
        external = points.comm.allreduce(external, op=MPI.SUM) + self._load_work(moved)
        self._work.add_stresses(points, state.fields, operator)
        self._add_works(external, sides, touching, damped, (before, after, strains), here, step)
        state.fields.update(new)
        self._work.projected += several.mapping_loss(new, kick)
        return commit(points, state)

    def _strays(self, rows: Sequence[Rows]) -> ParameterError | None:
        """The error about points that belong to no body, or about bodies without points, or None.

        A body may lose all its points after the first step. Collective.
        """
        tags, named = self._problem.points["tag"], tuple(self._collision.tags)
        stray = np.flatnonzero(~np.any(rows, axis=0)) if len(tags) else np.empty(0, np.intp)
        if not self._counted:
            self._counted = True
            counts = np.array([np.count_nonzero(own) for own in rows])
            self._problem.comm.Allreduce(MPI.IN_PLACE, counts, op=MPI.SUM)
            if not counts.all():
                return ParameterError(
                    f"no point has the tag {named[int(np.argmin(counts))]} of Collision(tags="
                    f"{named}), so nothing would touch it: give tags of the points, as in "
                    "fill(..., tag=2)"
                )
        if not stray.size:
            return None
        return ParameterError(
            f"{stray.size} points, such as those of tag {tags[stray[0]]}, belong to no body of "
            f"Collision(tags={named}): name all tags"
        )

    def _touching(self, bodies: Sequence[BodyAtNodes], here: Activation) -> NodalContact:
        """The nodes at which bodies touch."""
        basis, room = here.fields[0].basis, None
        assert isinstance(basis, LatticeBasis)
        if self.kinks is not None:
            self.kinks.begin_step(basis)
        if self._collision.gap_test:
            room = np.ones(basis.nodes.size)
            for k, line in enumerate(basis.lattice.lines):
                room *= integrals(line, basis.degree)[basis.halo.node_ijk[:, k]]
        return NodalContact(bodies, room, self._collision.friction, self.kinks)

    def _add_works(
        self,
        external: float,
        sides: BodiesAtSides,
        touching: NodalContact,
        damped: Sequence[Array],
        motion: tuple[Sequence[Array], Sequence[Array], Sequence[Array]],
        here: Activation,
        step: ExplicitStep,
    ) -> None:
        """Add the works of a step, and find the half-step energy of its velocities. Collective.

        Args:
            external: Work of loads and prescribed motions (J).
            sides, touching: Sides of the grid, and nodes at which bodies touch.
            damped: Forces of local damping (N), shape (nodes, d) per body.
            motion: Velocities at the start and at the end of the step, and velocities by which the
                bodies strain (m/s), shape (nodes, d) per body.
            here: The activation.
            step: The step.
        """
        (before, after, strains), dt, work = motion, step.dt, self._work
        owned = here.unknowns.fields[0].owned_nodes
        resisted = sum(
            0.5 * dt * float(np.sum((g * (V + V_end))[owned]))
            for g, V, V_end in zip(damped, before, after)
        )
        rubbed, absorbed = sides.losses(strains, dt)
        slipped, lost = touching.losses(before, strains, dt / step.kick, owned)
        received = touching.received[owned].sum(axis=0)
        sums = np.array([rubbed + slipped, resisted + absorbed, lost, *received])
        here.unknowns.comm.Allreduce(MPI.IN_PLACE, sums, op=MPI.SUM)
        friction, damping, collision = map(float, sums[:3])
        self.force = sums[3:] / step.kick
        work.external += external
        work.losses["friction"] += friction
        work.losses["damping"] += damping
        work.losses["collision"] += collision
        net = external - friction - damping
        work.half_step = half_step(net, work.stress_work, 0.0, False)

    def _load_work(self, moved: Array) -> float:
        """Work of the loads in a step (J). Collective."""
        points, loads = self._problem.points, self._loads
        way = moved - points["x"]
        f = loads.body
        if loads.uniform:
            f = point_masses(points)[:, None] * loads.gravity
        return points.comm.allreduce(float(np.sum(f * way)), op=MPI.SUM)


class SeveralBodies:
    """The bodies in one step: their points, with their stencils, and their nodes. Collective.

    Args:
        problem: The problem.
        rows: Mask of the points of each body, shape (points,) each.
        here: The activation.
        settings: Settings of the steps.

    Attributes:
        at_nodes: Nodal sums of each body.
    """

    @stages.assemble
    def __init__(
        self, problem: Problem, rows: Sequence[Rows], here: Activation, settings: Settings
    ):
        self._problem, self._points, self._here = problem, problem.points, here
        self._rows, self._settings = rows, settings
        self._stencils = [selected(here.fields[0].stencils, own) for own in rows]
        self._m = settings.mass_scaling * point_masses(self._points)
        self.at_nodes = [self._sums_of(s) for s in self._stencils]

    def _summed(self, components: int, add: Callable[[Array], None]) -> Array:
        """Sums at the nodes, on all ranks with the nodes, shape (nodes, components). Collective.

        Args:
            components: Number of components.
            add: Function that adds this rank's part.
        """
        sums = Nodal([self._here.fields[0].basis.nodes], [components])
        add(sums.arrays[0])
        sums.add_up()
        sums.spread()
        return sums.arrays[0].copy()

    def _sums_of(self, s: Stencils) -> BodyAtNodes:
        """Mass, volume and normal of a body. Collective."""
        m, d = point_masses(self._points), self._points.gdim
        both = np.column_stack([m, self._points["V"]])
        sums = self._summed(2, lambda out: scatter(s, np.ones(len(m)), both, out))
        weights = m[:, None, None] * np.eye(d)
        slope = self._summed(d, lambda out: scatter_stress(s, weights, out))
        return BodyAtNodes(self._settings.mass_scaling * sums[:, 0], sums[:, 1], slope)

    @stages.assemble
    def velocities(self, v: Array, sides: BodiesAtSides, ends: bool = False) -> list[Array]:
        """Nodal velocities of each body (m/s), from velocities of the points. Collective.

        Args:
            v: Velocities of the points (m/s), shape (points, d).
            sides: Sides of the grid, and conditions.
            ends: Whether these are velocities at the end of the step: sides hold stopped nodes.
        """
        found = []
        for s, body in zip(self._stencils, self.at_nodes):
            p = self._summed(v.shape[1], partial(scatter, s, self._m, v))
            found.append(p / body.divisor)
        sides.constrain(found)
        if ends:
            sides.constrain_stopped(found)
        return found

    @stages.assemble
    def forces(self, loads: FusedLoads) -> list[Array]:
        """Nodal forces of each body by its stresses and loads (N), shape (nodes, d). Collective."""
        points, n = self._points, len(self._points)
        declarations = self._problem.form.parts.declarations
        weight = stress_volumes(points, declarations, points["V"])

        def add(s: Stencils, out: Array) -> None:
            scatter_tensor(points, s, -weight[:, None, None] * points["stress"], out)
            if loads.uniform:
                given = np.broadcast_to(loads.gravity, (n, points.gdim))
                scatter(s, point_masses(points), given, out)
            else:
                scatter(s, np.ones(n), loads.body, out)

        return [self._summed(points.gdim, partial(add, s)) for s in self._stencils]

    @stages.assemble
    def exchange_mapped(
        self, touching: NodalContact, after: Sequence[Array], mapped: Sequence[Array]
    ) -> None:
        """Exchange momentum until mapped velocities of bodies do not approach. Collective.

        Args:
            touching: Nodes at which bodies touch, and the momentum exchanged so far.
            after: Velocities at the end of the step (m/s), shape (nodes, d) per body; changed.
            mapped: Velocities mapped from the points (m/s), shape (nodes, d) per body; changed.
        """
        n, fixed = len(self._points), self._here.unknowns.fields[0].fixed
        at = touching.nodes[:, None].astype(np.float64)
        near = [selected(s, collect(s, at, n)[:, 0] > 0.0) for s in self._stencils]
        for k in range(_PASSES):
            ahead = k / (k + 3.0) if k < _PASSES - 1 else 0.0
            changes = touching.exchange([V.copy() for V in mapped], ahead)
            for s, body, V, V_mapped, change in zip(near, self.at_nodes, after, mapped, changes):
                V += change
                change[fixed] = 0.0
                v = collect(s, change, n)
                p = self._summed(v.shape[1], partial(scatter, s, self._m, v))
                p[fixed] = 0.0
                V_mapped += p / body.divisor

    def energy_of_start(
        self, pushed: Sequence[Array], before: Sequence[Array], after: Sequence[Array]
    ) -> float:
        """Energy of the step that begins a run, see `Work` (J). Collective.

        Args:
            pushed: Changes of velocity by forces alone (m/s), shape (nodes, d) per body.
            before, after: Velocities at the start and at the end of the step, likewise.
        """
        own, start = self._here.unknowns.fields[0], 0.0
        for body, by_forces, V, V_end in zip(self.at_nodes, pushed, before, after):
            both = np.where(own.fixed, 0.0, by_forces * (V_end - V))
            start += 0.5 * float(np.sum((body.mass[:, None] * both)[own.owned_nodes]))
        return self._here.unknowns.comm.allreduce(start, op=MPI.SUM)

    def to_points(
        self, before: Sequence[Array], after: Sequence[Array], kick: float
    ) -> dict[str, Array]:
        """New velocities and accelerations of the points."""
        points, share = self._points, self._settings.mapping.flip_share
        v, a = points["velocity"].copy(), np.zeros_like(points["x"])
        for s, own, V, V_end in zip(self._stencils, self._rows, before, after):
            change, there = (collect(s, values, len(points))[own] for values in (V_end - V, V_end))
            v[own] = share * (v[own] + change) + (1.0 - share) * there
            a[own] = change / kick
        return {"velocity": v, "acceleration": a}

    def mapping_loss(self, new: dict[str, Array], kick: float) -> float:
        """Kinetic energy that the mapping takes from the points in a step (J). Collective."""
        change, filtered = kick * new["acceleration"], self._settings.scheme == "musl"
        own = mapping_loss(self._points["velocity"], change, new["velocity"], self._m, filtered)
        return self._points.comm.allreduce(own, op=MPI.SUM)

    def place(self, operator: Operator, increments: Sequence[Array]) -> None:
        """Evaluate the increments of its own body at each point."""
        value, gradient = operator.points.value[0], operator.points.gradient[0]
        found = np.zeros_like(value), np.zeros_like(gradient)
        for own, u in zip(self._rows, increments):
            operator.set_increments([u])
            found[0][own], found[1][own] = value[own], gradient[own]
        value[:], gradient[:] = found
