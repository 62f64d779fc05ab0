"""The general explicit step: any form, any grid, any mass, by stencils and the weak form.

The scheme is the order of the stress update (Bardenhagen 2002, doi 10.1006/jcph.2002.7103). "usl"
takes the velocity gradient from the new nodal velocities. "usf" takes it from the nodal velocities
before the forces. "musl" (Sulsky, Zhou & Schreyer 1995) maps the points' new velocities to the
nodes again, and takes the gradient of these velocities. In "musl" points also move by these
velocities, so that positions and strains follow one motion. With FLIP the kinetic energy changes by
the power of the forces on the same velocities, to second order. So a corner in contact must move by
them, too. Otherwise contact would make or lose energy.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform import stages
from dolfinmpm._platform.errors import raise_together
from dolfinmpm.assembly.term import NewState
from dolfinmpm.basis.stencils import Stencils
from dolfinmpm.body.axisymmetry import deformation
from dolfinmpm.body.loadbalance import balance
from dolfinmpm.cut.activation import Activation, ActiveField
from dolfinmpm.cut.unknowns import Nodal
from dolfinmpm.dynamics.boundaryforces import Stiffness, weighed
from dolfinmpm.dynamics.boundarywork import boundary_forces, works_of_boundaries
from dolfinmpm.dynamics.critical import cell_sizes_at, wave_speed
from dolfinmpm.dynamics.energies import stress_volumes
from dolfinmpm.dynamics.explicitbase import ExplicitBase
from dolfinmpm.dynamics.faces import Faces, set_velocities
from dolfinmpm.dynamics.halfstep import lateness, lateness_by_contact, mapping_loss
from dolfinmpm.dynamics.mappings import NodalMotion
from dolfinmpm.dynamics.mass import point_masses
from dolfinmpm.dynamics.nodalmass import Mass
from dolfinmpm.dynamics.sidedashpots import SideDashpots
from dolfinmpm.dynamics.smallmass import viscous_pressure
from dolfinmpm.dynamics.stepwork import energy_of_start, work_at_nodes, work_of_friction
from dolfinmpm.dynamics.transfer import collect, scatter_tensor
from dolfinmpm.solve.method import only_momentum
from dolfinmpm.solve.newstate import commit, new_state
from dolfinmpm.solve.operator import Operator
from dolfinmpm.solve.step import Step

__all__ = ["GeneralSteps"]

Array = npt.NDArray[np.float64]


class GeneralSteps(ExplicitBase):
    """Explicit steps of a problem of any form, one after the other."""

    _stiffness: Stiffness | None = None

    @cached_property
    def _resisting(self) -> dict[str, Array]:
        """Name of a loss → dissipative forces on the nodes in a step (N)."""
        return {}

    @cached_property
    def _by_stress(self) -> bool:
        """Whether the points' stress gives all internal forces except those of boundaries."""
        return only_momentum(self._problem.form, boundaries=False)

    def held(self) -> Stiffness:
        """Stiffness added by boundaries in the last step. Collective."""
        problem = self._problem
        if not problem.form.boundaries:
            return Stiffness()
        if self._stiffness is None or problem.here is None:
            self._stiffness = weighed(problem.form, problem.activate())[1]
        return self._stiffness

    def _activated(self, step: Step) -> Activation:
        """The activation of a step. Collective."""
        problem = self._problem
        raise_together(problem.points.comm, problem.points.error_in_fields())
        balance(problem.points)
        problem.bodies.begin(step.dt)
        here = problem.activate(step)
        if problem.form.boundaries:
            here, self._stiffness = weighed(problem.form, here)
        return here

    @stages.commit
    def _take(self, step: Step, kick: float) -> int | str:
        """Take one step; see `ExplicitBase`. Collective."""
        problem, settings = self._problem, self._settings
        points, dt = problem.points, step.dt
        here = self._activated(step)
        field = here.fields[0]
        s, x_node = field.stencils, field.basis.node_coordinates()
        mass = Mass(problem.terms, here, settings.scaling)
        held: Array = np.asarray(here.prescribed[0] / dt, np.float64)
        momenta = self._momenta(mass, field, x_node)
        before = self._before(step, kick, held, field.basis)
        fastest = float(np.abs(points["velocity"]).max(initial=0.0))
        V = mass.velocities(momenta, before, fastest).arrays[0]
        operator = Operator(problem.form, here)
        if self.kinks is not None:
            self.kinks.begin_step(field.basis)
        problem.bodies.put(0.0)
        V_strain, strained = self._before_forces(operator, mass, V, (dt, kick))
        predicted = strained * V_strain if settings.scheme == "usf" else None
        at_start = boundary_forces(operator)
        held_by = self._held_by(operator, at_start, predicted)
        forces = self._forces(operator, mass, s, predicted)
        if isinstance(forces, str):
            return forces
        if held_by is not None:
            forces.arrays[0][:] -= held_by
        self._watch(operator, False)
        problem.bodies.push(problem.bodies.acting(operator), kick)
        self._resist(forces, mass, s, V)
        net, grid = self._work.net, self._work.grid
        A = self._accelerations(forces, mass, V)
        V_end, stopped = self._end((V, A), mass, here, held, kick, step.t - dt)
        new = self._to_points(operator, field, x_node, NodalMotion(V, A, V_end, A), mass, dt)
        self._work.projected += self._projected(new, mass, collect(s, V_end - V))
        V_move = V_end
        if settings.scheme == "musl":
            V_move = mass.solve(self._momenta(mass, field, x_node, new), held).arrays[0]
            if stopped is not None:
                self._settle(here, stopped, V_move)
        V_strain = V_strain if settings.scheme == "usf" else V_move
        moved = points["x"] + dt * collect(s, V_move)
        operator.set_increments([strained * V_strain])
        if held_by is not None and settings.clock is not None:
            # the remaining part of a prescribed displacement is its value at the end of the step
            settings.clock.value = step.t
        problem.bodies.put(1.0)
        state = new_state(problem, operator, x=moved)
        if isinstance(state, str):
            return state
        self._watch(operator, True)
        self._work.external += work_at_nodes(operator, mass, forces, (V, V_end, V_move), dt, kick)
        self._work.losses["friction"] += work_of_friction(mass, stopped, dt * V_strain, kick)
        self._work.add_stresses(points, state.fields, operator)
        self._work.start += energy_of_start(mass, forces, V_end - V, here, dt, kick)
        self._count(mass, V, V_end, dt)
        state.fields.update(settings.mapping.at_new_positions(new, dt))
        held_work, late_work, _ = works_of_boundaries(operator, at_start, state)
        self._find_lateness(operator, net, grid, late_work)
        self._work.external += held_work + problem.bodies.commit(problem.bodies.acting(operator))
        return commit(points, state)

    def _watch(self, operator: Operator, ends: bool) -> None:
        """Keep which corners touch rigid bodies at an end of a step, if somebody asks for it."""
        if self.kinks is not None:
            for active in self._problem.bodies.acting(operator):
                self.kinks.add_corners(active, ends)

    def _to_points(
        self,
        operator: Operator,
        field: ActiveField,
        x_node: Array,
        motion: NodalMotion,
        mass: Mass,
        dt: float,
    ) -> dict[str, Array]:
        """New velocities, accelerations and affine parts of the points. Collective."""
        points, mapping = self._problem.points, self._settings.mapping
        gradient = np.zeros((len(points), points.gdim, points.gdim))
        if mapping.kind == "tpic":
            operator.set_increments([dt * motion.V_end])
            gradient = operator.points.gradient[0] / dt
        return mapping.to_points(points, field, x_node, motion, mass, dt, 1.0, gradient)

    def _find_lateness(self, operator: Operator, net: float, grid: float, held: float) -> None:
        """Find the lateness of the velocities at the end of a step, see `Work`. Collective.

        Args:
            operator: The step's equations, at the end of the step.
            net, grid: Sums of `Work` before the step (J).
            held: Work of the boundaries' forces at the end of the step (J).
        """
        work, bodies = self._work, self._problem.bodies
        late = self._settings.scheme == "usf"
        work.late = lateness(work.net - net, work.latest - held, work.grid - grid, late)
        if bodies.contacts:
            acting, comm = bodies.acting(operator), self._problem.comm
            more, work.late_bodies = lateness_by_contact(bodies, acting, comm)
            work.late += more

    def _projected(self, new: dict[str, Array], mass: Mass, change: Array) -> float:
        """Energy lost by the mapping in a step (J), see `Work`. Collective.

        Args:
            new: Fields of the points after the step.
            mass: Mass at the nodes.
            change: Changes of velocity of the nodes at the points (m/s), shape (points, d).
        """
        points, settings = self._problem.points, self._settings
        m = settings.scaling * point_masses(points)
        filtered = settings.scheme != "usl"
        own = mapping_loss(points["velocity"], change, new["velocity"], m, filtered)
        return mass.comm.allreduce(own, op=MPI.SUM)

    @stages.assemble
    def _momenta(self, mass: Mass, field: ActiveField, x_node: Array, new=None) -> Nodal:
        """Momenta of the nodes from the points' velocities, or from new velocities. Collective."""
        momenta = mass.nodal()
        self._settings.mapping.to_grid(self._problem.points, field, x_node, momenta, new)
        momenta.arrays[0][...] *= self._settings.scaling
        return momenta

    def _before(self, step: Step, kick: float, held: Array, basis: Any) -> Array:
        """Prescribed velocities at the start of a step (m/s), shape (nodes, d). Collective."""
        prescribed = self._problem.essential_conditions
        bcs = prescribed.conditions
        if not any(condition.velocity for condition in bcs):
            return held
        dt, share = step.dt, step.share
        ending = [np.array(bc.values) for bc in bcs]
        set_velocities(bcs, lambda v: v(step.t - 0.5 * dt - kick) * dt / share)
        values = prescribed.at([basis], share)[1][0] / dt
        for condition, value in zip(bcs, ending):
            if condition.velocity is not None:
                condition.value.value = value
        return np.asarray(values, np.float64)

    @stages.assemble
    def _forces(self, operator: Operator, mass: Mass, s: Stencils, u: Array | None) -> Nodal | str:
        """Forces on the nodes by the present stresses, or by the stresses after an increment u.

        Collective. Returns the reason of a failure if no state exists after the increment.
        """
        forces = mass.nodal()
        points = self._problem.points
        state: NewState | None = None
        if u is not None:
            operator.set_increments([u])
            found = new_state(self._problem, operator, stays=True)
            if isinstance(found, str):
                return found
            state = found
        if not self._by_stress:
            if state is None:
                operator.move_to_zero()
            forces.arrays[0][:] = -operator.forces(without=("boundary", "penalty"))[0]
            return forces
        weight = points["V"]
        if state is not None:
            at = operator.points
            weight = weight * np.linalg.det(deformation(points, at.value[0], at.gradient[0]))
        stress = points["stress"] if state is None else state.fields["stress"]
        weight = stress_volumes(points, self._problem.form.parts.declarations, weight)
        scatter_tensor(points, s, weight[:, None, None] * stress, forces.arrays[0])
        forces.arrays[0][:] *= -1.0
        forces.add_up()
        forces.arrays[0][:] -= operator.external[0]
        if operator.has("contact"):
            operator.update_contact()
            forces.arrays[0][:] -= operator.forces_of("contact")[0]
        return forces

    def _held_by(
        self, operator: Operator, at_start: list[Array] | None, u: Array | None
    ) -> Array | None:
        """Internal forces of boundaries, at the start or after an increment u. Collective."""
        if at_start is None or u is None:
            return None if at_start is None else at_start[0]
        operator.set_increments_of("boundary", [u])
        return operator.forces_of("boundary")[0]

    @stages.assemble
    def _resist(self, forces: Nodal, mass: Mass, s: Stencils, V: Array) -> None:
        """Change the forces by bulk viscosity, and by filters of light nodes. Collective."""
        points, b = self._problem.points, self._settings.viscosity
        if b != (0.0, 0.0):
            speeds = wave_speed(points, self._problem.form.parts.declarations)
            viscous = mass.nodal()
            sizes = cell_sizes_at(points, self._problem.fields[0].space)
            pressure = viscous_pressure(points, s, V, b, speeds, sizes)
            if self.kinks is not None:
                self.kinks.add_closing(points["id"], pressure[:, 0, 0])
            scatter_tensor(points, s, pressure, viscous.arrays[0])
            viscous.add_up()
            forces.arrays[0][:] -= viscous.arrays[0]
            self._resisting["viscosity"] = viscous.arrays[0]
        for one in self._settings.filters:
            one.act(V, forces.arrays[0], mass, s)

    @stages.solve
    def _accelerations(self, forces: Nodal, mass: Mass, V: Array) -> Array:
        """Accelerations of the nodes, with local damping. Collective."""
        damping = self._settings.damping
        if damping:
            f = forces.arrays[0]
            damped = damping * np.abs(f) * np.sign(V)
            if self.kinks is not None:
                self.kinks.add_damped(V)
            f -= damped
            self._resisting["damping"] = damped
        return mass.solve(forces, np.zeros_like(V)).arrays[0]

    @stages.solve
    def _end(
        self, motion: tuple[Array, Array], mass: Mass, here: Activation, held: Array, dt: float,
        t: float,
    ) -> tuple[Array, Array | None]:  # fmt: skip
        """Velocities at the end of a step, with faces of the grid and conditions. Collective.

        Waves come in with their forces at the time t of the positions.

        Returns:
            The velocities (m/s), shape (nodes, d), and what frictional faces have taken from them,
            likewise, or None without such faces.
        """
        V, A = motion
        V_end = V + dt * A
        faces = self.sides.on(here.fields[0].basis, t)
        fixed = here.unknowns.fields[0].fixed
        if faces is not None and faces.dashpots is not None:
            V_end[fixed] = held[fixed]
            V_end = self._damped(V, V_end, mass, here, faces, dt, t)
        stopped = None
        if faces is not None and self.sides.rubbing:
            free = V_end.copy()
            faces.rub(V_end, self.kinks)
            stopped = free - V_end
            # what conditions hold is not moved by friction
            stopped[fixed] = 0.0
        V_end[fixed] = held[fixed]
        return V_end, stopped

    def _settle(self, here: Activation, taken: Array, V: Array) -> None:
        """Hold nodes that frictional faces have stopped, but for conditions; see `Faces.settle`."""
        faces, fixed = self.sides.on(here.fields[0].basis), here.unknowns.fields[0].fixed
        assert faces is not None
        given = V[fixed]
        faces.settle(taken, V, self.kinks)
        V[fixed] = given

    def _before_forces(
        self, operator: Operator, mass: Mass, V: Array, times: tuple[float, float]
    ) -> tuple[Array, float]:
        """Velocities for the strain (m/s), and the time during which they strain (s). Collective.

        In "usf" the strain before the forces is that by the last motion of the points, of the last
        step's length. The forces before it tell which nodes frictional faces will stop.
        """
        (dt, kick), here = times, operator.here
        if self._settings.scheme != "usf":
            return V, dt
        last, faces = 2.0 * kick - dt, self.sides.on(here.fields[0].basis)
        if faces is None or not self.sides.rubbing:
            return V, last
        forces = self._forces(operator, mass, here.fields[0].stencils, None)
        assert isinstance(forces, Nodal)
        if (held_by := self._held_by(operator, boundary_forces(operator), None)) is not None:
            forces.arrays[0][:] -= held_by
        free = V + kick * mass.solve(forces, np.zeros_like(V)).arrays[0]
        V_end, settled = free.copy(), V.copy()
        faces.rub(V_end, self.kinks)
        self._settle(here, free - V_end, settled)
        return settled, last

    def _damped(
        self, V: Array, V_end: Array, mass: Mass, here: Activation, faces: Faces, dt: float,
        t: float,
    ) -> Array:  # fmt: skip
        """Velocities after dashpots and incoming waves. Collective."""
        problem, settings, field = self._problem, self._settings, here.fields[0]
        own, waves = here.unknowns.fields[0], faces.waves
        free = np.zeros_like(own.fixed)
        free[own.owned_nodes] = ~own.fixed[own.owned_nodes]
        assert faces.dashpots is not None
        sides = SideDashpots(mass, faces.dashpots, waves.forces(t), free, dt)
        if problem.terms.kind == "consistent":
            damped, at_side = sides.consistent(V_end)
        elif settings.gives_back and (waves or field.C is not None):
            weight = settings.scaling * point_masses(problem.points)
            damped, at_side = sides.lumped(V_end, V, field.stencils, weight)
        else:
            # as in the fused loop
            damped = at_side = sides.by_nodes(V_end)
        came, lost = sides.works(at_side)
        self._work.external += came
        self._work.losses["damping"] += lost
        return damped

    def _count(self, mass: Mass, V: Array, V_end: Array, dt: float) -> None:
        """Add the change of the nodes' kinetic energy, and the losses by dissipative forces.

        Collective. Kinetic energy of a ghost mass exists only within a step. It is no loss, because
        points get the work of all forces.
        """
        found = [sum(mass.kinetic(v)) for v in (V, V_end)]
        self._work.grid += found[1] - found[0]
        owned = mass.nodes.owned
        for name, force in self._resisting.items():
            done = 0.5 * dt * float(np.sum(force[:owned] * (V + V_end)[:owned]))
            self._work.losses[name] += mass.comm.allreduce(done, op=MPI.SUM)
        self._resisting.clear()
