"""Explicit steps in time: what every step does to any form, on any grid, with any mass.

Orders of the stress update (Bardenhagen 2002, doi 10.1006/jcph.2002.7103): "usl" takes the
velocity gradient from the new nodal velocities, "usf" from those before the forces, "musl"
(Sulsky, Zhou & Schreyer 1995) from the points' new velocities mapped to the nodes again.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfinmpm._platform.checks import choice, number
from dolfinmpm._platform.errors import InstabilityError, ParameterError, raise_together
from dolfinmpm.basis import LatticeBasis
from dolfinmpm.basis.conditions import Condition
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.unknowns import Nodal
from dolfinmpm.dynamics.clock import Time
from dolfinmpm.dynamics.critical import critical_step
from dolfinmpm.dynamics.energies import Energies, Work, angular_momentum, momentum_of
from dolfinmpm.dynamics.fusable import Laws, Loads, why_not
from dolfinmpm.dynamics.fused import Fused
from dolfinmpm.dynamics.mappings import Mapping, NodalMotion, mapping_of
from dolfinmpm.dynamics.mass import KINDS, Mass, MassTerms, mass_terms
from dolfinmpm.dynamics.newmark import MotionRecord
from dolfinmpm.dynamics.transfer import collect, scatter_stress
from dolfinmpm.grid.lattice import largest_cell
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
        time: fem.Constant | None = None,
        fused: bool = True,
        **options: Any,
    ):
        self.scheme = choice("scheme", scheme, SCHEMES)
        self.mapping = mapping_of(mapping, "flip")
        mass = choice("mass", mass, KINDS)
        self.courant = number("courant", courant, 0.0)
        self._damping = number("damping", damping, 0.0, 1.0, closed=True)
        self._scaling = number("mass_scaling", mass_scaling, 0.0)
        if self.mapping.kind == "accel":
            raise ParameterError('mapping = "accel" is of implicit steps; use "flip"')
        u = increments_of(increment, points)
        if len(u) > 1 or u[0].ufl_shape != (points.gdim,):
            raise ParameterError(
                "explicit steps move one field, a displacement of as many components as space has "
                "dimensions"
            )
        self.mapping.add_fields(points)
        super().__init__(form, increment, points, bcs, **options)
        self.terms: MassTerms = mass_terms(self.form, self.fields[0], mass, ghost_mass)
        self.form.inertia = self.terms
        self.time = 0.0
        self._clock = time
        self._work = Work()
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
        """Angular momentum about the origin (kg m²/s), shape (1,) or in 3D (3,). Collective."""
        return angular_momentum(self.points)

    def critical_step(self) -> float:
        """The longest step that is stable, by wave speed and grid (s). Collective."""
        self.form.bind()
        basis = self.fields[0].space.basis
        declarations = self.form.parts.declarations
        found = critical_step(self.points, basis, declarations, self.terms.kind)
        return math.sqrt(self._scaling) * found

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
                longest = self.courant * self.critical_step()
            left = target - self.time
            count = math.ceil(left / longest * (1 - 1e-12))
            dt = left / count if not single else min(left, longest)
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
        V = mass.solve(momenta, held).arrays[0]
        operator = self.form.on(here)
        forces = self._forces(operator, mass, s, dt * V if self.scheme == "usf" else None)
        if isinstance(forces, str):
            raise self._unstable(forces, dt)
        A = self._accelerations(forces, mass, V)
        V_end = V + dt * A
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
        external = operator.external_work([dt * V_end])
        # what holds a node does work on it: the impulse that momentum and forces leave over
        impulse = mass.times(V_end).arrays[0] - momenta.arrays[0] - dt * forces.arrays[0]
        owned = here.unknowns.fields[0].owned_nodes
        work = np.where(fixed, impulse * V_end, 0.0)[owned]
        external += self.comm.allreduce(float(np.sum(work)), op=MPI.SUM)
        self._work.add(points, state.fields, operator, external)
        state.fields.update(new)
        return commit(points, state)

    def _momenta(self, mass: Mass, s, x_node: Array, new=None) -> Nodal:
        """Momenta of the nodes from velocities of the points, or from new ones. Collective."""
        momenta = mass.nodal()
        self.mapping.to_grid(self.points, s, x_node, momenta, new)
        momenta.arrays[0][...] *= self._scaling
        return momenta

    def _forces(self, operator, mass: Mass, s, u: Array | None) -> Nodal | str:
        """Forces on the nodes in the present state, or of the stresses after an increment.

        Collective. Returns why there are none where the increment admits no state.
        """
        forces = mass.nodal()
        if u is None:
            operator.rest()
            forces.arrays[0][:] = -operator.forces()[0]
            return forces
        operator.place([u])
        state = advance(
            operator, self._updates, False, largest_cell(self.points.grid), len(self.history) + 1
        )
        if isinstance(state, str):
            return state
        points, d = self.points, self.points.gdim
        J = np.linalg.det(operator.points.gradient[0] + np.eye(d))
        weight = J * points["V"]
        for declaration in self.form.parts.declarations:
            if declaration.strain == "small":
                weight[declaration.rows] = points["V0"][declaration.rows]
        stress = weight[:, None, None] * state.fields["stress"][:, :d, :d]
        scatter_stress(s, stress, forces.arrays[0])
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
            f"{energies.external:.4g}. The state is that before the step: take a smaller courant "
            'number, a mapping that damps, mass="consistent" or aggregation where cuts are small'
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
