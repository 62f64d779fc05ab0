"""Explicit steps on rectangular grids by fused loops, for supported forms.

A form of momentum terms and loads on a lattice needs no stencils, no activation and no form
assembly. One loop over the points does all: it maps the nodes' motion to each point, strains and
moves the point, and adds its mass, momentum and forces to the nodes at the new position. Nodes are
stored in a window of the lattice around this rank's cells, by their position. Rigid bodies act on
the nodes between two such loops.
"""

from __future__ import annotations

from collections.abc import Callable, Set
from dataclasses import dataclass
from typing import Any

import numpy as np
from mpi4py import MPI

from dolfinmpm._platform import stages
from dolfinmpm.basis import LatticeBasis
from dolfinmpm.dynamics.energies import half_step
from dolfinmpm.dynamics.explicitbase import ExplicitStep, Settings, strain_interval
from dolfinmpm.dynamics.facesatnodes import Sides
from dolfinmpm.dynamics.fusable import FusedLoads
from dolfinmpm.dynamics.fusedcontact import RigidContacts
from dolfinmpm.dynamics.fusedloop import kernel
from dolfinmpm.dynamics.nodes import divide, move_nodes
from dolfinmpm.dynamics.passes import COLUMNS, GROWTH, MEANS, NEO, PASSES, Pass, Switches
from dolfinmpm.dynamics.pointarrays import Laws, PointArrays
from dolfinmpm.dynamics.window import MARGIN, Prescribed, Window, WindowMeans
from dolfinmpm.dynamics.worksums import Work

__all__ = ["FusedSteps"]

# Mappings with an affine part: their numbers in the loops, and the field of the affine part
_AFFINE = {"apic": (1, "velocity_moment"), "tpic": (2, "velocity_gradient")}


@dataclass
class Worth:
    """Validity of the window and the arrays of former steps.

    Attributes:
        live: Whether the arrays belong to the last step of this call.
        kept: Whether window and arrays come from a former call.
        travelled: Path of the fastest point since the window was made, in cells.
        touched: Fields that may have changed since the last call.
    """

    live: bool = False
    kept: bool = False
    travelled: float = 0.0
    touched: Set[str] = frozenset()


class FusedSteps:
    """The fused loops of a problem.

    Args:
        problem: The problem, for which `why_not` has no reason.
        settings: Settings of the steps.
        sides: Sides of the grid that act on the body.

    Attributes:
        done: Sums since the last call of `work`, in this order: work of the stresses (J), work of
            loads and prescribed motions (J), path of the fastest point in a step (cells), change
            of the nodes' kinetic energy (J), losses by damping and by friction at sides of the
            grid (J), half-step energy (J), loss by the mapping (J) and energy of the start (J); see
            `Work`.
        at_once: Largest number of steps per call.
        instead: Reason for other steps: empty, because these steps are fused.
        sides: The argument.
    """

    at_once, instead = 20, ""
    _means: WindowMeans | None = None
    _arrays: PointArrays

    def __init__(self, problem: Any, settings: Settings, sides: Sides):
        form, points, bodies = problem.form, problem.points, problem.bodies
        self._points, self._settings, self.sides = points, settings, sides
        space = problem.fields[0].space
        self._basis: LatticeBasis = space.basis
        self._laws = Laws(points, form.parts.declarations)
        self._loads = FusedLoads(form)
        self._prescribed = at_nodes = Prescribed(problem.essential_conditions)
        self._rigid = RigidContacts(bodies, points, at_nodes) if bodies.contacts else None
        self.done = np.zeros(9)
        self._rate, self._worth = 0.0, Worth()
        self._growth = GROWTH[space.domains] if space.basis.averaged else 0
        self._window: Any = None

    @property
    def keeps_speed(self) -> bool:
        """Whether the critical step follows from the points' fields alone."""
        return self._rigid is None

    def work(self) -> Work:
        """Works and losses since the last call of this method. Collective."""
        if self._laws.kind == NEO:
            self.done[0] = self._laws.gained()
        sums = self._points.comm.allreduce(self.done, op=MPI.SUM)
        internal, external, _, grid, damped, rubbed, half, mapped, start = map(float, sums)
        self.done[:2] = self.done[3:] = 0.0
        if self._rigid is not None:
            external, self._rigid.work = external + self._rigid.work, 0.0
        projected = self._settings.mass_scaling * mapped
        found = Work(external, internal, grid, projected, start, half_step=half)
        if self._rigid is not None:
            more, found.of_bodies = self._rigid.half_step
            found.half_step = half + more
        found.losses["damping"], found.losses["friction"] = damped, rubbed
        return found

    def renew(self) -> None:
        """Start the next call like the first call, with a new window and sorted points."""
        self._window, self._worth.kept = None, False

    @stages.activate
    def start(self, rate: float, touched: Set[str]) -> None:
        """Read the present state of the points before a series of steps. Collective.

        Args:
            rate: Prescribed velocities over prescribed increments (1/s).
            touched: Fields that may have changed since the last series, on any rank. Data that
                depend on other fields only are reused.
        """
        self._rate, self._worth.live = rate, False
        self._worth.touched = touched
        self._surround()
        self._laws.start(touched)

    def release(self) -> None:
        """Release references to the fields' arrays between calls, so that nothing changes them."""
        self._laws.release()
        if self._worth.kept:
            self._arrays.release()

    def _surround(self) -> None:
        """Make a window around the cells computed by this rank. Collective."""
        points = self._points
        if self._window is None or self._window.basis.partition is not points.partition:
            self._window, self._worth.kept = Window(points, self._basis, self.sides), False
            if self._laws.fbar:
                self._means = WindowMeans(self._window)
        self._window.cells.sort(points)
        self._prescribed.start(self._window, self._rate)

    @stages.evaluate
    def run(
        self, count: int, more: bool, begin: Callable[[int], ExplicitStep]
    ) -> tuple[int, int, str | None]:
        """Take equal steps; see `ExplicitBase.run`. Collective.

        In the times of stages, a whole loop over the points counts as evaluation.
        """
        migrated, reason, taken = 0, None, 0
        *others, main = PASSES[self._settings.scheme]
        while taken < count and reason is None:
            step = begin(taken)
            middle = step.start + 0.5 * step.dt
            self._prescribed.drive(middle - step.kick, middle)
            fresh = not self._worth.live
            if fresh:
                with stages.activate:
                    if self._window.basis.partition is not self._points.partition:
                        self._surround()
                        self._prescribed.drive(middle - step.kick, middle)
                    self._prepare()
                self._worth.live = True
            elif self._loads.changed():
                # loads that differ between points are in the nodal forces already
                fresh = not self._loads.uniform
                self._loads.evaluate()
                fresh = fresh or not self._loads.uniform
                if fresh:
                    self._arrays.strain()
            if fresh:
                reason = self._scatter(main, step.dt)
            if self._laws.calls is not None:
                self._laws.calls.moment[[0, 2]] = strain_interval(step, self._settings.scheme)
            taken += 1
            last = taken == count
            # the sums of the last step of all would not be used
            ending = last and not more
            if reason is None:
                reason = self._step(others, main, step, last, not ending)
            way = self._reach()
            self._worth.travelled += way
            if reason is None and self._rigid is not None:
                reason = self._rigid.end(way, last)
            if reason is None and last:
                self._laws.scatter()
            if reason is None and (ending or self._worth.travelled > 0.5 * MARGIN):
                if not last:
                    self._arrays.publish()
                self._laws.scatter()
                with stages.migrate:
                    migrated += self._window.cells.update(self._points)
                self._worth.live = False
        self._worth.live = self._worth.live and reason is None
        self._window.cells.steps += taken
        return taken, migrated, reason

    def _reach(self) -> float:
        """Path of the fastest point in the step on all ranks, in cells. Collective."""
        fastest, self.done[2] = float(self.done[2]), 0.0
        comm = self._points.comm
        return fastest if comm.size == 1 else comm.allreduce(fastest, op=MPI.MAX)

    def _prepare(self) -> None:
        """Prepare the points' arrays in the layout of the loops. Collective."""
        _, field = _AFFINE.get(self._settings.mapping.kind, (0, None))
        touched, self._worth.touched = self._worth.touched, frozenset()
        if touched & {"x", "l"} or not self._worth.kept or not 2 * self._worth.travelled <= MARGIN:
            self._window.box(self._points)
            self._worth.travelled = 0.0
        self._laws.gather(frozenset())
        if self._worth.kept and self._arrays.still(touched):
            self._arrays.take()
        else:
            self._arrays = PointArrays(self._points, self._laws, field)
        self._worth.kept = True
        self._loads.follow(touched)
        if self._rigid is not None:
            self._rigid.surround(self._window)

    # -- passes -----------------------------------------------------------------

    def _pass(self, parts: Pass, dt: float, switches: Switches) -> str | None:
        """Run one pass over the points; returns the reason of a failure, or None. Collective."""
        if self._means is None or not parts.strain:
            return self._once(parts, dt, switches)
        taken, used = MEANS[self._laws.fbar]
        reason = None
        if switches.advance:
            self._means.sums[:] = 0.0
            first = Pass(strain=True, moved=parts.moved)
            reason = self._once(first, dt, Switches(), taken)
            self._means.take(self._window.rows())
        return reason or self._once(parts, dt, switches, used)

    def _once(self, parts: Pass, dt: float, switches: Switches, means: int = 0) -> str | None:
        general = not self._window.basis.lattice.uniform
        bad, left = -1, len(self._points)
        if left:
            rows, skipped = self._arrays.rows, self._arrays.skipped
            if not general:
                bad, left, behind = self._loop(parts, dt, switches, rows, False, means)
                if bad < 0 and behind:
                    only = switches._replace(advance=False)
                    late = skipped[1, :behind].copy()
                    bad, *_ = self._loop(parts, dt, only, late, True, means)
                rows = skipped[0]
            if bad < 0 and left:
                bad, *_ = self._loop(parts, dt, switches, rows[:left].copy(), True, means)
        return self._failure_of(bad)

    def _loop(
        self, parts: Pass, dt: float, switches: Switches, rows, general: bool, means: int = 0
    ) -> tuple[int, int, int]:
        laws, arrays, window, mapping = (
            self._laws, self._arrays, self._window, self._settings.mapping
        )  # fmt: skip
        affine, _ = _AFFINE.get(mapping.kind, (0, None))
        share = mapping.flip_share
        data: tuple[Any, ...] = (*arrays.data, self._loads.body)
        if self._means is not None and means:
            data = (*data, self._means.sums, arrays.J_bar)
        if laws.calls is not None:
            data = (*data, laws.calls.data)
        loop = kernel(
            self._points.gdim, window.basis.degree, self._growth, laws.kind, affine, parts, general,
            means, laws.calls is not None, self._points.axisymmetric,
        )  # fmt: skip
        return loop(
            window.grid, window.nodes, window.out, data, laws.table, dt, share, *switches, rows,
            arrays.skipped, self.done,
        )  # fmt: skip

    def _failure_of(self, bad: int) -> str | None:
        points = self._points
        found = None
        if bad >= 0:
            calls = self._laws.calls
            why = calls.failure() if calls is not None else ""
            why = f"the UMAT {why}" if why else "it has no stress, no volume or has left the grid"
            found = (
                f"point {points['id'][bad]} at {points['x'][bad]} m: {why} "
                f"(det F = {np.linalg.det(points['F'][bad]):.4g})"
            )
            lines = self._basis.lattice.lines
            if not all(line[0] <= c <= line[-1] for c, line in zip(points["x"][bad], lines)):
                found += "; it is outside: enlarge the grid, or hold this side with mpm.rollers"
        if points.comm.size == 1:
            return found
        all_found = [text for text in points.comm.allgather(found) if text is not None]
        return all_found[0] if all_found else None

    def _scatter(self, parts: Pass, dt: float) -> str | None:
        self._window.out[:] = 0.0
        reason = self._pass(parts, dt, Switches(advance=False))
        self._window.add_up()
        return reason

    def _step(
        self, others, main: Pass, step: ExplicitStep, record: bool, scatter: bool
    ) -> str | None:
        """Take one step from the nodal sums. Collective."""
        self._window.cover(self._points)
        before = self.done.copy()
        reason = self._passes(others, main, step, record, scatter)
        if record:
            _, external, _, grid, damped, rubbed, internal, _, _ = self.done - before
            stress_first = self._settings.scheme == "usf"
            self.done[6] = half_step(external - damped - rubbed, internal, grid, stress_first)
            if step.kick != step.dt:
                self._points["acceleration"] *= step.dt / step.kick
        return reason

    def _passes(
        self, others, main: Pass, step: ExplicitStep, record: bool, scatter: bool
    ) -> str | None:
        """Run the passes of a step, and update the nodes between them. Collective."""
        switches, dt, kick = Switches(record, scatter=scatter), step.dt, step.kick
        window, prescribed, settings = self._window, self._prescribed, self._settings
        d = self._points.gdim
        columns, box = COLUMNS[d], window.rows()
        out, nodes, fixed, before = window.out, window.nodes, prescribed.fixed, prescribed.before
        usf, usl = settings.scheme == "usf", settings.scheme == "usl"
        weight = (
            window.sides, window.own, self._loads.gravity, dt, kick, settings.mass_scaling,
            settings.damping, self.done,
        )  # fmt: skip
        rigid = self._rigid
        if rigid is not None:
            rigid.begin(step, usf)
        # only forces make the points' acceleration, not prescribed motions of nodes
        apart = record and (prescribed.driven or len(self.sides) > 0)
        pushed = np.zeros((len(nodes), d)) if apart else np.empty((0, d))
        if usf:
            divide(box, columns, out, 0, nodes, fixed, before, *weight, False)
            # strains before the forces follow the last motion of the points
            reason = self._pass(others[0], step.before, switches)
            window.add_up(columns.force, columns.force + d)
            if reason is not None:
                return reason
        if rigid is not None:
            rigid.press(out)
        move_nodes(
            box, columns, out, nodes, window.own, fixed, before, prescribed.after, window.sides,
            pushed, self._loads.gravity, dt, kick, step.begins, settings.mapping.kept_share,
            settings.mass_scaling, settings.damping, usf, usf or usl, self.done,
        )  # fmt: skip
        changes = window.at_points(pushed, self._points) if apart else None
        if not (usf or usl):
            reason = self._pass(others[0], dt, switches)
            window.add_up(columns.second, columns.second + d)
            if reason is not None:
                return reason
            divide(box, columns, out, columns.second, nodes, fixed, prescribed.after, *weight, True)
        if rigid is not None:
            rigid.follow()
        reason = self._pass(main, dt, switches)
        if scatter:
            window.add_up()
        if changes is not None:
            self._points["acceleration"][:] = changes / dt
        return reason
