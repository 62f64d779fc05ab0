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
from dolfinmpm.dynamics.boundarywork import boundary_forces, pending_work, works_of_boundaries
from dolfinmpm.dynamics.clock import velocities_at
from dolfinmpm.dynamics.energies import by_contact, half_step, mapping_loss, stress_volumes
from dolfinmpm.dynamics.explicitbase import ExplicitBase, ExplicitStep, strain_by, strain_interval
from dolfinmpm.dynamics.facesatnodes import Faces
from dolfinmpm.dynamics.mappings import NodalMotion
from dolfinmpm.dynamics.mass import point_masses
from dolfinmpm.dynamics.nodalmass import Mass
from dolfinmpm.dynamics.sidedashpots import SideDashpots
from dolfinmpm.dynamics.smallmass import BulkViscosity
from dolfinmpm.dynamics.stepwork import (
    add_losses,
    energy_of_start,
    work_at_nodes,
    work_of_frictional_sides,
)
from dolfinmpm.dynamics.transfer import collect, scatter_tensor
from dolfinmpm.grid.tensors import determinants
from dolfinmpm.solve.method import only_momentum
from dolfinmpm.solve.newstate import commit, new_state
from dolfinmpm.solve.operator import Operator

__all__ = ["GeneralSteps"]

Array = npt.NDArray[np.float64]


class GeneralSteps(ExplicitBase):
    """Explicit steps of a problem of any form, one after the other."""

    _stiffness: Stiffness | None = None
    # of the last step: dashpots of sides, and the velocities that they resist
    _at_sides: tuple[SideDashpots, Array] | None = None

    @cached_property
    def _resisting(self) -> dict[str, Array]:
        """Name of a loss → dissipative forces on the nodes in a step (N)."""
        return {}

    @cached_property
    def viscosity(self) -> BulkViscosity | None:
        """Bulk viscosity, or None without it."""
        problem, coefficients = self._problem, self._settings.viscosity
        if coefficients == (0.0, 0.0):
            return None
        declarations = problem.form.parts.declarations
        return BulkViscosity(problem.points, problem.fields[0].space, declarations, coefficients)

    @cached_property
    def _by_stress(self) -> bool:
        """Whether the points' stress gives all internal forces except those of boundaries."""
        return only_momentum(self._problem.form, boundaries=False)

    def boundary_stiffness(self) -> Stiffness:
        """Stiffness added by boundaries in the last step. Collective."""
        problem = self._problem
        if not problem.form.boundaries:
            return Stiffness()
        if self._stiffness is None or problem.here is None:
            self._stiffness = weighed(problem.form, problem.activate())[1]
        return self._stiffness

    def _activated(self, step: ExplicitStep) -> Activation:
        """The activation of a step. Collective."""
        problem = self._problem
        raise_together(problem.points.comm, problem.points.error_in_fields())
        balance(problem.points)
        problem.bodies.begin(step.dt)
        here = problem.activate(step)
        if problem.form.boundaries:
            here, self._stiffness = weighed(problem.form, here)
        if self.kinks is not None:
            self.kinks.begin_step(here.fields[0].basis)
        return here

    @stages.commit
    def _take(self, step: ExplicitStep) -> int | str:
        """Take one step; see `ExplicitBase`. Collective."""
        problem, settings = self._problem, self._settings
        points, dt = problem.points, step.dt
        here = self._activated(step)
        points.interval = strain_interval(step, settings.scheme)
        field = here.fields[0]
        s, x_node = field.stencils, field.basis.node_coordinates()
        mass = Mass(problem.terms, here, settings.mass_scaling)
        prescribed: Array = np.asarray(here.prescribed[0] / dt, np.float64)
        momenta = self._momenta(mass, field, x_node)
        V = self._velocities(mass, momenta, here, step, prescribed)
        operator = Operator(problem.form, here)
        problem.bodies.put(0.0)
        V_strain, strain_time = self._strain_velocities(operator, mass, V, step)
        u_strain = strain_time * V_strain if settings.scheme == "usf" else None
        at_start = boundary_forces(operator)
        by_boundaries = self._of_boundaries(operator, at_start, u_strain)
        forces = self._forces(operator, mass, s, u_strain)
        if isinstance(forces, str):
            return forces
        if by_boundaries is not None:
            forces.arrays[0][:] -= by_boundaries
        self._watch(operator, ends=False)
        problem.bodies.push(problem.bodies.acting(operator), step.kick)
        self._resist(forces, mass, s, V)
        work, net, grid = self._work, self._work.net, self._work.grid
        A = self._accelerations(forces, mass, V)
        V_end, taken = self._end((V, A), mass, here, prescribed, step)
        new = self._to_points(operator, field, x_node, NodalMotion(V, A, V_end, A), mass, dt)
        work.projected += self._projected(new, mass, collect(s, V_end - V))
        V_move = V_end
        if settings.scheme == "musl":
            V_move = mass.solve(self._momenta(mass, field, x_node, new), prescribed).arrays[0]
            if taken is not None:
                self._constrain_stopped(here, taken, V_move)
        V_strain = V_strain if settings.scheme == "usf" else V_move
        moved = points["x"] + dt * collect(s, V_move)
        strain_by(operator, points, strain_time * V_strain, settings.scheme)
        if by_boundaries is not None and settings.clock is not None:
            # boundaries prescribe what is left of a displacement, measured at the step's end
            settings.clock.value = step.t
        problem.bodies.put(1.0)
        state = new_state(problem, operator, x=moved, moved=[dt * V_move])
        if isinstance(state, str):
            return state
        self._watch(operator, ends=True)
        motion, kept = (V, V_end, V_move), settings.mapping.kept_share
        work.external += work_at_nodes(operator, mass, forces, motion, step, momenta, kept)
        work.losses["friction"] += work_of_frictional_sides(mass, taken, dt * V_strain, step.kick)
        work.add_stresses(points, state.fields, operator)
        if step.begins:
            work.start += energy_of_start(mass, forces, V_end - V, here, step.kick)
        add_losses(work, mass, motion, self._resisting, self._at_sides, step.kick)
        self._resisting.clear()
        state.fields.update(settings.mapping.at_new_positions(new, dt))
        boundary_work, at_end = works_of_boundaries(operator, at_start, state)
        self._find_half_step(operator, net, grid, at_end)
        work.pending = pending_work(operator, at_start, dt * V_move, settings.scheme)
        of_bodies = problem.bodies.commit(problem.bodies.acting(operator))
        work.external += boundary_work + of_bodies
        return commit(points, state)

    def _watch(self, operator: Operator, ends: bool) -> None:
        """Keep which corners touch rigid bodies at an end of a step, if somebody asks for it."""
        if self.kinks is not None:
            for active in self._problem.bodies.acting(operator):
                self.kinks.add_corners(active, ends)

    def _to_points(
        self, operator: Operator, field: ActiveField, x_node: Array, motion: NodalMotion,
        mass: Mass, dt: float,
    ) -> dict[str, Array]:  # fmt: skip
        """New velocities, accelerations and affine parts of the points. Collective."""
        points, mapping = self._problem.points, self._settings.mapping
        gradient = np.zeros((len(points), points.gdim, points.gdim))
        if mapping.kind == "tpic":
            operator.set_increments([dt * motion.V_end])
            gradient = operator.points.gradient[0] / dt
        return mapping.to_points(points, field, x_node, motion, mass, dt, 1.0, gradient)

    def _find_half_step(self, operator: Operator, net: float, grid: float, at_end: float) -> None:
        """Find the half-step energy of the velocities at the end of a step, see `Work`. Collective.

        Args:
            operator: The step's equations, at the end of the step.
            net, grid: Sums of `Work` before the step (J).
            at_end: Work of the boundaries' forces at the end of the step (J).
        """
        work, bodies = self._work, self._problem.bodies
        usf = self._settings.scheme == "usf"
        work.half_step = half_step(work.net - net, work.stress_work - at_end, work.grid - grid, usf)
        if bodies.contacts:
            acting, comm = bodies.acting(operator), self._problem.comm
            more, work.of_bodies = by_contact(bodies, acting, comm, usf)
            work.half_step += more
        for term in operator.others:
            work.half_step += (1.5 if usf else 0.5) * term.work_at_end()

    def _projected(self, new: dict[str, Array], mass: Mass, change: Array) -> float:
        """Energy lost by the mapping in a step (J), see `Work`. Collective.

        Args:
            new: Fields of the points after the step.
            mass: Mass at the nodes.
            change: Changes of velocity of the nodes at the points (m/s), shape (points, d).
        """
        points, settings = self._problem.points, self._settings
        m = settings.mass_scaling * point_masses(points)
        filtered = settings.scheme != "usl"
        own = mapping_loss(points["velocity"], change, new["velocity"], m, filtered)
        return mass.comm.allreduce(own, op=MPI.SUM)

    def _velocities(
        self, mass: Mass, momenta: Nodal, here: Activation, step: ExplicitStep, after: Array
    ) -> Array:
        """Velocities of the nodes at the start of a step (m/s), shape (nodes, d). Collective."""
        middle_of_last, dt = step.t - 0.5 * step.dt - step.kick, step.dt
        (before,) = velocities_at(
            self._problem, here, step, lambda v: v(middle_of_last) * dt / step.share
        )
        if step.begins:
            # when a run begins, nodes of a moving side still have the points' velocities
            before = np.where(after != 0.0, mass.own_velocities(momenta), before)
        fastest = float(np.abs(self._problem.points["velocity"]).max(initial=0.0))
        return mass.velocities(momenta, before, fastest).arrays[0]

    @stages.assemble
    def _momenta(self, mass: Mass, field: ActiveField, x_node: Array, new=None) -> Nodal:
        """Momenta of the nodes from the points' velocities, or from new velocities. Collective."""
        momenta = mass.nodal()
        self._settings.mapping.to_grid(self._problem.points, field, x_node, momenta, new)
        momenta.arrays[0][...] *= self._settings.mass_scaling
        return momenta

    @stages.assemble
    def _forces(self, operator: Operator, mass: Mass, s: Stencils, u: Array | None) -> Nodal | str:
        """Forces on the nodes by the present stresses, or by the stresses after an increment u.

        Collective. Returns the reason of a failure if no state exists after the increment.
        """
        forces = mass.nodal()
        points = self._problem.points
        state: NewState | None = None
        if u is not None:
            strain_by(operator, points, u, self._settings.scheme)
            found = new_state(self._problem, operator, stays=True)
            if isinstance(found, str):
                return found
            state = found
        if not self._by_stress:
            if state is None:
                operator.move_to_zero()
            forces.arrays[0][:] = -operator.forces(without=("boundary", "penalty", "contact"))[0]
            return self._with_contact(forces, operator, mass)
        weight = points["V"]
        if state is not None:
            at = operator.points
            weight = weight * determinants(deformation(points, at.value[0], at.gradient[0]))
        stress = points["stress"] if state is None else state.fields["stress"]
        weight = stress_volumes(points, self._problem.form.parts.declarations, weight)
        scatter_tensor(points, s, weight[:, None, None] * stress, forces.arrays[0])
        forces.arrays[0][:] *= -1.0
        forces.add_up()
        forces.arrays[0][:] -= operator.external[0]
        return self._with_contact(forces, operator, mass)

    def _with_contact(self, forces: Nodal, operator: Operator, mass: Mass) -> Nodal:
        """Forces with those of contact at the start of the step. Collective.

        In "usf" too contact takes zero increments: those of the operator belong to the last step.
        """
        if operator.has("contact"):
            operator.update_contact(mass.nodal().arrays)
            forces.arrays[0][:] -= operator.forces_of("contact")[0]
        return forces

    def _of_boundaries(
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
        points = self._problem.points
        if self.viscosity is not None:
            viscous, pressure = mass.nodal(), self.viscosity.pressure(s, V)
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
        return mass.accelerations(forces)

    @stages.solve
    def _end(
        self, motion: tuple[Array, Array], mass: Mass, here: Activation, prescribed: Array,
        step: ExplicitStep,
    ) -> tuple[Array, Array | None]:  # fmt: skip
        """Velocities at the end of a step, with faces of the grid and conditions. Collective.

        Returns:
            The velocities (m/s), shape (nodes, d), and what frictional faces have taken from them,
            likewise, or None without such faces.
        """
        V, A = motion
        V_end = V + step.kick * A
        faces = self.sides.on(here.fields[0].basis, step, here.fields[0].C)
        fixed = here.unknowns.fields[0].fixed
        if faces is not None and faces.dashpots is not None:
            V_end[fixed] = prescribed[fixed]
            V_end = self._damped(V, V_end, mass, here, faces, step)
        taken = None
        if faces is not None and self.sides.frictional:
            free = V_end.copy()
            faces.apply_friction(V_end, self.kinks)
            taken = free - V_end
            # what conditions hold is not moved by friction
            taken[fixed] = 0.0
        V_end[fixed] = prescribed[fixed]
        return V_end, taken

    def _constrain_stopped(self, here: Activation, taken: Array, V: Array) -> None:
        """See `Faces.constrain_stopped`. What conditions prescribe stays."""
        faces, fixed = self.sides.on(here.fields[0].basis), here.unknowns.fields[0].fixed
        assert faces is not None
        given = V[fixed]
        faces.constrain_stopped(taken, V, self.kinks)
        V[fixed] = given

    def _strain_velocities(
        self, operator: Operator, mass: Mass, V: Array, step: ExplicitStep
    ) -> tuple[Array, float]:
        """Velocities for the strain (m/s), and the time during which they strain (s). Collective.

        In "usf" the strain before the forces is that by the last motion of the points, of the last
        step's length. The forces before it tell which nodes frictional faces will stop.
        """
        here = operator.here
        if self._settings.scheme != "usf":
            return V, step.dt
        last, faces = step.before, self.sides.on(here.fields[0].basis)
        if faces is None or not self.sides.frictional:
            return V, last
        forces = self._forces(operator, mass, here.fields[0].stencils, None)
        assert isinstance(forces, Nodal)
        by_boundaries = self._of_boundaries(operator, boundary_forces(operator), None)
        if by_boundaries is not None:
            forces.arrays[0][:] -= by_boundaries
        free = V + step.kick * mass.solve(forces, np.zeros_like(V)).arrays[0]
        V_end, stopped_too = free.copy(), V.copy()
        faces.apply_friction(V_end, self.kinks)
        self._constrain_stopped(here, free - V_end, stopped_too)
        return stopped_too, last

    def _damped(
        self, V: Array, V_end: Array, mass: Mass, here: Activation, faces: Faces,
        step: ExplicitStep,
    ) -> Array:  # fmt: skip
        """Velocities after dashpots, and after waves with their forces at the start. Collective."""
        problem, settings, field = self._problem, self._settings, here.fields[0]
        own, waves = here.unknowns.fields[0], faces.wave_forces(step.start)
        free = np.zeros_like(own.fixed)
        free[own.owned_nodes] = ~own.fixed[own.owned_nodes]
        assert faces.dashpots is not None
        sides = SideDashpots(mass, faces.dashpots, waves, free, step.kick)
        if problem.terms.kind == "consistent":
            damped, at_side = sides.consistent(V_end, V)
        elif settings.gives_back and (faces.incoming or field.C is not None):
            weight = settings.mass_scaling * point_masses(problem.points)
            damped, at_side = sides.lumped(V_end, V, field.stencils, weight)
        else:
            # as in the fused loop
            damped, at_side = sides.by_nodes(V_end, V)
        self._at_sides = sides, at_side
        return damped
