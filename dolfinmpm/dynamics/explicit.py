"""Explicit steps in time: what every step does to any form, on any grid, with any mass.

Orders of the stress update (Bardenhagen 2002, doi 10.1006/jcph.2002.7103): "usl" takes the
velocity gradient from the new nodal velocities, "usf" from those before the forces, "musl"
(Sulsky, Zhou & Schreyer 1995) from the points' new velocities mapped to the nodes again.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfinmpm._platform.checks import choice, number
from dolfinmpm._platform.errors import InstabilityError, ParameterError, raise_together
from dolfinmpm.assembly.points import Matrix
from dolfinmpm.basis import LatticeBasis
from dolfinmpm.basis.conditions import Condition
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.unknowns import Nodal
from dolfinmpm.dynamics.clock import Time
from dolfinmpm.dynamics.critical import critical_step, wave_speed
from dolfinmpm.dynamics.energies import Energies, Work, angular_momentum, momentum_of
from dolfinmpm.dynamics.faces import Faces, divided, set_velocities
from dolfinmpm.dynamics.fusable import Laws, Loads, only_momentum, why_not
from dolfinmpm.dynamics.fused import Fused
from dolfinmpm.dynamics.lightnodes import checked_viscosity, filters, viscous_pressure
from dolfinmpm.dynamics.mappings import Mapping, NodalMotion, mapping_of
from dolfinmpm.dynamics.mass import KINDS, Mass, MassTerms, mass_terms, point_masses
from dolfinmpm.dynamics.newmark import MotionRecord
from dolfinmpm.dynamics.transfer import collect, scatter_stress
from dolfinmpm.grid.lattice import largest_cell
from dolfinmpm.solve import spectra
from dolfinmpm.solve.advance import advance, commit
from dolfinmpm.solve.arguments import increments_of
from dolfinmpm.solve.loads import check_loads
from dolfinmpm.solve.problem import Problem
from dolfinmpm.solve.step import Step

__all__ = ["Explicit"]

Array = npt.NDArray[np.float64]
SCHEMES = ("usl", "usf", "musl")

# how often the critical step is found anew, and the energies are looked at
_EVERY = 20


class Explicit(Problem):
    """A weak form in time, by explicit steps: no tangent, no Newton iteration, no factorisation.

    The form is that of the quasi-static problem, internal forces less loads; what it moves has
    mass, the points' `density`. The points carry `velocity` (m/s) and `acceleration` (m/s²).

    `step(t)` goes to a time in as many steps as stability asks for; in a loop over
    `times(end, dt="auto")` each call takes one.

    Args:
        form, increment, points, bcs, updates, stabilisation, prolongation: See `QuasiStatic`.
            Penalties on the increment do nothing here: explicit steps take no tangent.
        scheme: "musl", "usl" or "usf".
        mapping: How velocities go to the grid and come back; "flip" by default.
        mass: "lumped", or "consistent" with conjugate gradients in each step.
        ghost_mass: See `Newmark`.
        courant: Share of the critical step that is taken.
        damping: Share α of local damping, −α |f| sign v (Cundall 1987).
        mass_scaling: Factor of the mass in the inertia, not in loads: steps grow by its root.
        bulk_viscosity: Linear and quadratic coefficients of the pressure ρ h (b₁ c |ε̇| + b₂² h ε̇²)
            against fast compression (von Neumann & Richtmyer 1950), about (0.06, 1.2).
        mass_cutoff: Nodes of less than this share of the largest mass stand still (Sulsky,
            Zhou & Schreyer 1995).
        redistribution: Nodes of less than this share of the largest mass hand that part of
            their forces that their mass lacks to their neighbours (Ma, Zhang & Qiu 2010).
        time: DOLFINx constant that holds the time (s), for forms that depend on it.
        fused: Whether one loop may do a step of a form that it knows: laws under large or small
            strain and loads, lumped mass, a rectangular grid, "flip", "pic", "apic" or "tpic".

    Attributes:
        history: One record a call of `step`.
        time: Time that the state is of (s).

    Raises:
        ParameterError: An argument is not what it may be.
    """

    history: list[MotionRecord]  # type: ignore[assignment]
    _of_step = MotionRecord
    _in_time = True

    def __init__(
        self,
        form: ufl.Form,
        increment: fem.Function | Sequence[fem.Function],
        points: MaterialPoints,
        bcs: Sequence[Condition] = (),
        *,
        scheme: str = "musl",
        mapping: Mapping | str | None = None,
        mass: str = "lumped",
        ghost_mass: float | None = None,
        courant: float = 0.8,
        damping: float = 0.0,
        mass_scaling: float = 1.0,
        bulk_viscosity: tuple[float, float] = (0.0, 0.0),
        mass_cutoff: float = 0.0,
        redistribution: float = 0.0,
        time: fem.Constant | None = None,
        fused: bool = True,
        **options: Any,
    ):
        self.scheme = choice("scheme", scheme, SCHEMES)
        mass = choice("mass", mass, KINDS)
        self.courant = number("courant", courant, 0.0)
        self._damping = number("damping", damping, 0.0, 1.0, closed=True)
        self._scaling = number("mass_scaling", mass_scaling, 0.0)
        self._viscosity = checked_viscosity(bulk_viscosity)
        self._filters = filters(mass_cutoff, redistribution)
        u = increments_of(increment, points)
        chosen = mapping_of(mapping, "flip")
        if chosen.kind == "accel":
            raise ParameterError('mapping = "accel" is of implicit steps; use "flip"')
        self.mapping = chosen.on(u[0]._dolfinmpm_space.basis, mass)
        if len(u) > 1 or u[0].ufl_shape != (points.gdim,):
            raise ParameterError(
                "explicit steps move one field, a displacement of as many components as space has "
                "dimensions"
            )
        self.mapping.add_fields(points)
        conditions, self._faces = divided(bcs)
        super().__init__(form, increment, points, conditions, **options)
        self._on: dict[Any, Faces] = {}
        self.terms: MassTerms = mass_terms(self.form, self.fields[0], mass, ghost_mass)
        self.form.inertia = self.terms
        self._by_stress = only_momentum(self.form)
        self.time = 0.0
        self._clock = time
        self._work = Work()
        self._first_energy: float | None = None
        self._last_energy = 0.0
        self._most = 0.0
        self._fused: Fused | None = None
        #: Why steps are not fused, or an empty string.
        self.unfused = "it was not to be" if not fused else self._fuse(options) or ""

    def _fuse(self, options: dict[str, Any]) -> str | None:
        """Take the fused loops, or say why not."""
        basis, remedy = self.fields[0].space.basis, self.fields[0].remedy
        if not isinstance(basis, LatticeBasis):
            return "the grid is not rectangular"
        if self.terms.kind != "lumped":
            return "the mass is consistent"
        if self._faces or self._filters or self._viscosity != (0.0, 0.0):
            return "faces of the grid, bulk viscosity or filters of light nodes act"
        if any(condition.velocity for condition in self.bcs):
            return "velocities are prescribed in time"
        if basis.averaged and self.fields[0].space.domains != "stretch":
            return "domains grow by another rule than the stretch"
        if remedy.ties_nodes or options.get("prolongation") or options.get("updates"):
            return "nodes are tied, or fields updated"
        if self.mapping.kind not in ("flip", "pic", "apic", "tpic"):
            return "the mapping filters velocities at the nodes"
        reason = why_not(self.form)
        if reason is not None:
            return reason
        loads = Loads(self.form)
        if not loads.known or loads.varies:
            return "loads that depend on functions of the grid or on what moves"
        laws = Laws(self.points, self.form.parts.declarations)
        self._fused = Fused(
            self.points, basis, self._held, laws, loads, self.scheme, self.mapping, self._scaling,
            self._damping,
        )  # fmt: skip
        return None

    def energies(self) -> Energies:
        """Energies of the body now, and work done since the first step. Collective."""
        return Energies.of(self.points, self.form.parts.declarations, self._work)

    def momentum(self) -> Array:
        """Linear momentum of the body (kg m/s), shape (d,). Collective."""
        return momentum_of(self.points)

    def angular_momentum(self) -> Array:
        """Angular momentum about the origin (kg m²/s), shape (1,) or in 3D (3,). Collective.

        That of the affine parts which "apic" gives the points is counted.
        """
        spins = self.mapping.kind == "apic"
        return angular_momentum(self.points, self.points["velocity_moment"] if spins else None)

    def critical_step(self, exact: bool = False) -> float:
        """The longest step that is stable (s). Collective.

        Args:
            exact: Whether it is that of the eigenproblem K x = λ M x of the present state,
                2/√λ_max, for which the tangent is compiled; else it is by wave speed and grid.
        """
        if exact:
            return self._exact_step()
        self.form.bind()
        basis = self.fields[0].space.basis
        declarations = self.form.parts.declarations
        found = critical_step(self.points, basis, declarations, self.terms.kind)
        return math.sqrt(self._scaling) * found

    def _exact_step(self) -> float:
        """2/√λ_max of the tangent and the mass, of the points' terms alone. Collective."""
        here = self.activate()
        # explicit steps take no tangent, and so no penalties on the increment
        fields = tuple(replace(field, penalty=None) for field in here.fields)
        operator = self.form.on(replace(here, grid=[], soft=[], fields=fields))
        operator.rest()
        K, M = (Matrix(here.pattern, here.unknowns) for _ in range(2))
        operator.tangent(K)
        Mass(self.terms, here, self._scaling).add_to(M)
        return spectra.critical_step(K.petsc, M.petsc)

    def step(self, t: float) -> MotionRecord:
        """Go to a time. Collective.

        Args:
            t: The time (s), later than `time`; or one of `times(end, dt="auto")`, for one step of
                the length that stability allows.

        Raises:
            ParameterError: The time is not later.
            InstabilityError: The state is not finite, or energy comes from nowhere.
            PointsOutsideGridError: Points would leave the grid.
        """
        started, single = clock.perf_counter(), isinstance(t, Time) and t.open
        target = t.end if isinstance(t, Time) else number("t", t, unit="s")
        if not target > self.time:
            raise ParameterError(
                f"t = {target:g} s must be later than the time of the state, {self.time:g} s"
            )
        record = MotionRecord()
        check_loads(self._loads.items, self.form.given, self.bcs, self.comm)
        whole = target - self.time
        if self._fused is not None:
            raise_together(self.comm, self.points.fault())
            self._fused.start(1.0 / whole)
        while self.time < target:
            if record.parts % _EVERY == 0:
                self._check_energy(record.dt, begins=record.parts == 0)
                longest = self.courant * self.critical_step()
            left = target - self.time
            count = math.ceil(left / longest * (1 - 1e-12))
            dt = left / count if not single else min(left, longest)
            moving = any(c.velocity is not None for c in self.bcs)
            if moving:
                at = self.time + dt
                set_velocities(self.bcs, lambda v: v(at) * whole)  # noqa: B023
            if self._fused is not None:
                now = 1 if single else min(count, _EVERY)
                self._advance_fused(now, dt, now < count and not single, record)
            else:
                record.migrated += self._advance_by(Step(self.time + dt, dt, dt / whole))
                record.parts, self.time, record.dt = record.parts + 1, self.time + dt, dt
            if abs(self.time - target) <= 1e-9 * dt:
                # rounding must not add a step
                self.time = target
            if single:
                break
        self._loads.release()
        self._check_energy(record.dt)
        record.time = self.time
        record.unknowns = self.here.unknowns.total if self.here is not None else 0
        record.seconds = clock.perf_counter() - started
        self.history.append(record)
        if isinstance(t, Time):
            t.reached = self.time
        return record

    def _advance_fused(self, count: int, dt: float, more: bool, record: MotionRecord) -> None:
        """Equal steps by the fused loops. Collective."""
        assert self._fused is not None
        start = self.time

        def set_time(taken: int) -> None:
            if self._clock is not None:
                self._clock.value = start + taken * dt

        fused = self._fused
        taken, migrated, reason = fused.run(count, dt, more, set_time)
        self._work.internal, self._work.external = fused.work()
        record.parts, record.migrated = record.parts + taken, record.migrated + migrated
        self.time, record.dt = start + taken * dt, dt
        if reason is not None:
            raise self._unstable(reason, dt)

    def _advance_by(self, step: Step) -> int:
        """One step; returns how many points changed rank. Collective."""
        points, dt = self.points, step.dt
        if self._clock is not None:
            self._clock.value = self.time
        raise_together(self.comm, points.fault())
        here = self.activate(step)
        field = here.fields[0]
        s, x_node = field.stencils, field.basis.node_coordinates()
        mass = Mass(self.terms, here, self._scaling)
        held: Array = np.asarray(here.prescribed[0] / dt, np.float64)
        momenta = self._momenta(mass, s, x_node)
        V = mass.solve(momenta, self._before(step, held, field.basis)).arrays[0]
        operator = self.form.on(here)
        forces = self._forces(operator, mass, s, dt * V if self.scheme == "usf" else None)
        if isinstance(forces, str):
            raise self._unstable(forces, dt)
        if self._viscosity != (0.0, 0.0):
            stress = viscous_pressure(points, s, V, self._viscosity, self._wave_speeds())
            viscous = mass.nodal()
            scatter_stress(s, stress, viscous.arrays[0])
            viscous.add_up()
            forces.arrays[0][:] -= viscous.arrays[0]
        for one in self._filters:
            one.act(V, forces.arrays[0], mass, s)
        A = self._accelerations(forces, mass, V)
        V_end = V + dt * A
        faces = self._faces_on(field.basis)
        if faces is not None and faces.dashpots is not None:
            m = np.where(mass.lumped > 0, mass.lumped, np.inf)[:, None]
            V_end /= 1.0 + dt * faces.dashpots / m
        if faces is not None:
            faces.rub(V_end)
        fixed = here.unknowns.fields[0].fixed
        V_end[fixed] = held[fixed]
        motion = NodalMotion(V, A, V_end, A)
        gradient = np.zeros((len(points), points.gdim, points.gdim))
        if self.mapping.kind == "tpic":
            operator.place([dt * V_end])
            gradient = operator.points.gradient[0] / dt
        new = self.mapping.to_points(points, s, x_node, motion, mass, dt, 1.0, gradient)
        moved = points["x"] + dt * collect(s, V_end)
        V_strain = V if self.scheme == "usf" else V_end
        if self.scheme == "musl":
            V_strain = mass.solve(self._momenta(mass, s, x_node, new), held).arrays[0]
        operator.place([dt * V_strain])
        state = advance(
            operator, self._updates, True, largest_cell(points.grid), len(self.history) + 1, moved
        )
        if isinstance(state, str):
            raise self._unstable(state, dt)
        external = operator.load_work([dt * V_end])
        if here.driven:
            # what moves held nodes gives them momentum against their forces
            impulse = mass.times(V_end - V).arrays[0] - dt * forces.arrays[0]
            at = here.unknowns.fields[0].places[1]
            done = float(impulse.reshape(-1)[at] @ V_end.reshape(-1)[at])
            external += self.comm.allreduce(done, op=MPI.SUM)
        self._work.add(points, state.fields, operator, external)
        state.fields.update(new)
        return commit(points, state)

    def _momenta(self, mass: Mass, s, x_node: Array, new=None) -> Nodal:
        """Momenta of the nodes from velocities of the points, or from new ones. Collective."""
        momenta = mass.nodal()
        self.mapping.to_grid(self.points, s, x_node, momenta, new)
        momenta.arrays[0][...] *= self._scaling
        return momenta

    def _before(self, step: Step, held: Array, basis: Any) -> Array:
        """Velocities of held components at the start of a step, shape (nodes, d). Collective."""
        if not any(condition.velocity for condition in self.bcs):
            return held
        dt, share = step.dt, step.share
        ending = [np.array(bc.increment) for bc in self.bcs]
        set_velocities(self.bcs, lambda v: v(step.t - dt) * dt / share)
        values = self._held.at([basis], share)[1][0] / dt
        for condition, value in zip(self.bcs, ending):
            if condition.velocity is not None:
                condition.value.value = value  # type: ignore[union-attr]
        return np.asarray(values, np.float64)

    def _forces(self, operator, mass: Mass, s, u: Array | None) -> Nodal | str:
        """Forces on the nodes in the present state, or of the stresses after an increment.

        Collective. Returns why there are none where the increment admits no state.
        """
        forces = mass.nodal()
        if u is None and not self._by_stress:
            operator.rest()
            forces.arrays[0][:] = -operator.forces()[0]
            return forces
        points, d = self.points, self.points.gdim
        weight, stress = points["V"].copy(), points["stress"]
        if u is not None:
            operator.place([u])
            cell = largest_cell(points.grid)
            state = advance(operator, self._updates, False, cell, len(self.history) + 1)
            if isinstance(state, str):
                return state
            weight *= np.linalg.det(operator.points.gradient[0] + np.eye(d))
            stress = state.fields["stress"]
        for declaration in self.form.parts.declarations:
            if declaration.strain == "small":
                weight[declaration.rows] = points["V0"][declaration.rows]
        scatter_stress(s, weight[:, None, None] * stress[:, :d, :d], forces.arrays[0])
        forces.arrays[0][:] *= -1.0
        forces.add_up()
        forces.arrays[0][:] -= operator.external[0]
        return forces

    def _accelerations(self, forces: Nodal, mass: Mass, V: Array) -> Array:
        """Accelerations of the nodes, with local damping. Collective."""
        if self._damping:
            f = forces.arrays[0]
            f -= self._damping * np.abs(f) * np.sign(V)
        return mass.solve(forces, np.zeros_like(V)).arrays[0]

    def _check_energy(self, dt: float, begins: bool = False) -> None:
        """Raise InstabilityError if energy comes from nowhere. Collective.

        What the user gives the points between two calls of `step` does not, see `begins`.

        What moves may lose energy to the grid and gain a little in "usf"; more than half of all
        that there ever was in any form comes from a step that is too long.
        """
        m = self._scaling * point_masses(self.points)
        kinetic = 0.5 * float(np.sum(m[:, None] * self.points["velocity"] ** 2))
        kinetic = self.comm.allreduce(kinetic, op=MPI.SUM)
        work = self._work
        total = kinetic + work.internal - work.external
        if self._first_energy is None:
            self._first_energy = self._last_energy = total
            # of a body under stress: its work in an increment is that of a large stress
            stored = self.energies().strain
            self._most = abs(stored) if math.isfinite(stored) else 0.0
        if begins:
            self._first_energy += total - self._last_energy
        self._last_energy = total
        self._most = max(self._most, abs(self._first_energy), abs(work.external))
        gained = total - self._first_energy
        if not math.isfinite(total) or gained > 0.5 * self._most > 0.0:
            raise self._unstable(
                f"{gained:.4g} J have come from nowhere beside {self._most:.4g} J of first energy "
                "and work of loads",
                dt,
            )

    def _wave_speeds(self) -> Array:
        return wave_speed(self.points, self.form.parts.declarations)

    def _faces_on(self, basis: Any) -> Faces | None:
        """Faces of the grid in a basis's numbering. Collective when asked first."""
        if not self._faces:
            return None
        if basis not in self._on:
            self._on[basis] = Faces(self._faces, basis, self.points.gdim)
        return self._on[basis]

    def _unstable(self, reason: str, dt: float) -> InstabilityError:
        """What is known of a step that ended in no state. Collective."""
        points = self.points
        speed = np.linalg.norm(points["velocity"], axis=1)
        worst = None
        if len(points):
            p = int(np.argmax(np.where(np.isfinite(speed), speed, np.inf)))
            worst = (float(speed[p]), int(points["id"][p]), points["x"][p].tolist())
        found = [w for w in self.comm.allgather(worst) if w is not None]
        fastest = max(found)
        energies = self.energies()
        return InstabilityError(
            f"explicit step at t = {self.time:.6g} s: {reason}. The step is {dt:.3g} s, the "
            f"critical one {self.critical_step():.3g} s; the fastest point is {fastest[1]} at "
            f"{fastest[2]} m with {fastest[0]:.3g} m/s; energies (J): kinetic "
            f"{energies.kinetic:.4g}, strain {energies.strain:.4g}, external work "
            f"{energies.external:.4g}. "
            + (
                "The fused loops have moved points in part: go on from a checkpoint, with "
                if self._fused is not None
                else "The state is that before the step: take "
            )
            + "a smaller courant number, a mapping that damps, or aggregation where cuts are small"
        )

    def _memory(self) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
        state, local, cells = super()._memory()
        work = np.array([self._work.external, self._work.internal])
        return {**state, "time": self.time, "work": work}, local, cells

    def _remember(self, state, local, cells) -> None:
        super()._remember(state, local, cells)
        self.time = state["time"]
        self._work.external, self._work.internal = state["work"]

    def _problem(self) -> dict[str, Any]:
        return {**super()._problem(), "mapping": repr(self.mapping)}
