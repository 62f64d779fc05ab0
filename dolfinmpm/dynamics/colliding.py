"""Explicit steps of bodies that collide, each with velocities of its own at the nodes."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform import stages
from dolfinmpm._platform.errors import FormError, ParameterError, raise_together
from dolfinmpm.basis import LatticeBasis
from dolfinmpm.basis.bspline import integrals
from dolfinmpm.basis.stencils import Stencils, gather, selected
from dolfinmpm.body.balance import balance
from dolfinmpm.cut.held import Held
from dolfinmpm.cut.participants import Activation
from dolfinmpm.cut.unknowns import Nodal
from dolfinmpm.dynamics.collision import BodyAtNodes, Collision, collide
from dolfinmpm.dynamics.energies import Work
from dolfinmpm.dynamics.faces import Sides
from dolfinmpm.dynamics.fusable import Loads
from dolfinmpm.dynamics.mass import point_masses
from dolfinmpm.dynamics.settings import Settings
from dolfinmpm.dynamics.transfer import scatter, scatter_stress, scatter_tensor
from dolfinmpm.grid.lattice import largest_cell
from dolfinmpm.solve.advance import advance, commit
from dolfinmpm.solve.operator import Operator
from dolfinmpm.solve.problem import Problem
from dolfinmpm.solve.step import Step

__all__ = ["Colliding", "why_it_does_not_collide"]

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.bool_]


def why_it_does_not_collide(problem: Problem, mass: str, settings: Settings) -> Exception | None:
    """What is wrong with a problem whose bodies are to collide, or None."""
    field, parts = problem.fields[0], problem.form.parts
    if not isinstance(field.space.basis, LatticeBasis):
        return ParameterError("Collision asks for room at the nodes; take a rectangular grid")
    if problem.points.axisymmetric:
        return ParameterError("Collision is of plane bodies and bodies in 3D, these are rings")
    if mass != "lumped" or settings.mapping.kind not in ("flip", "pic"):
        return ParameterError(
            f'mass = "{mass}" and mapping = "{settings.mapping.kind}" do not go with Collision: '
            'give mass="lumped" and mapping="flip" or "pic"'
        )
    if settings.scheme == "usf" or not settings.plain or field.ties_nodes or field.prolongate:
        return ParameterError(
            'Collision goes with scheme="musl" or "usl", without bulk viscosity, filters of light '
            "nodes, or remedies that tie nodes"
        )
    if parts.contacts or any(d.fbar for d in parts.declarations):
        return FormError("Collision goes neither with rigid bodies nor with F-bar; leave these out")
    if not Loads(problem.form).known:
        return FormError("Collision needs loads by the points' fields and constants alone")
    return None


class Colliding:
    """Explicit steps of a problem whose bodies collide, one after the other.

    Args:
        problem: The problem.
        held: Its essential conditions.
        updates: Fields of the points that a step sets to UFL expressions.
        settings: How steps are taken.
        sides: Faces of the grid that act on the bodies.
        collision: Which bodies touch, and how.

    Attributes:
        at_once: Steps that one call may take.
        instead: Why steps are not fused.
        force: What the others did to the first body in the last step (N), shape (d,).
    """

    at_once, instead = 1, "bodies collide"

    def __init__(
        self,
        problem: Problem,
        held: Held,
        updates: Sequence,
        settings: Settings,
        sides: Sides,
        collision: Collision,
    ):
        self._problem, self._held, self._updates = problem, held, updates
        self._settings, self._sides, self._collision = settings, sides, collision
        self._loads = Loads(problem.form)
        self._work = Work()
        self.force: Array = np.zeros(problem.points.gdim)

    def work(self) -> tuple[float, float]:
        """Work (J) of the stresses, and of loads, since last asked."""
        done, self._work = self._work, Work()
        return done.internal, done.external

    def start(self, rate: float) -> None:
        """Begin a call; the points are taken as they are in every step."""

    def run(
        self, count: int, dt: float, more: bool, begin: Callable[[int], Step]
    ) -> tuple[int, int, str | None]:
        """Take equal steps; see `General.run`. Collective."""
        migrated = 0
        for k in range(count):
            found = self._take(begin(k))
            if isinstance(found, str):
                return k, migrated, found
            migrated += found
        return count, migrated, None

    @stages.commit
    def _take(self, step: Step) -> int | str:
        """One step; how many points changed rank, or why there is no state. Collective."""
        problem, settings = self._problem, self._settings
        points, dt = problem.points, step.dt
        raise_together(points.comm, points.fault())
        balance(points)
        here = problem.activate(step)
        self._loads.evaluate()
        rows = self._collision.bodies(points["tag"])
        raise_together(points.comm, self._strays(rows))
        stencils = [selected(here.fields[0].stencils, own) for own in rows]
        held: Array = np.asarray(here.prescribed[0] / dt, np.float64)
        bodies = [self._at_nodes(s, here) for s in stencils]
        room = self._room(here) if self._collision.gap_test else None
        before = [
            self._velocity(s, b, here, held, points["velocity"]) for s, b in zip(stencils, bodies)
        ]
        after = [self._driven(s, b, V, here, held, dt) for s, b, V in zip(stencils, bodies, before)]
        got = collide(bodies, after, room, self._collision.friction)
        self._hold(after, here, held)
        new, moved = self._points(stencils, rows, before, after, dt)
        strains = after
        if settings.scheme == "musl":
            strains = [
                self._velocity(s, b, here, held, new["velocity"]) for s, b in zip(stencils, bodies)
            ]
            self._hold(strains, here, held)
        operator = problem.form.on(here)
        self._place(operator, rows, [dt * V for V in strains])
        state = advance(
            operator,
            self._updates,
            True,
            largest_cell(points.grid),
            len(problem.history) + 1,
            moved,
        )
        if isinstance(state, str):
            return state
        self._work.add(points, state.fields, operator, self._external(moved))
        state.fields.update(new)
        owned = here.unknowns.fields[0].owned_nodes
        self.force = points.comm.allreduce(got[owned].sum(axis=0), op=MPI.SUM) / dt
        return commit(points, state)

    def _strays(self, rows: Sequence[Rows]) -> ParameterError | None:
        """What is wrong with points that belong to no body, or None."""
        tags = self._problem.points["tag"]
        stray = np.flatnonzero(~np.any(rows, axis=0)) if len(tags) else np.empty(0, np.intp)
        if not stray.size:
            return None
        return ParameterError(
            f"{stray.size} points, such as those of tag {tags[stray[0]]}, belong to no body of "
            f"Collision(tags={tuple(self._collision.tags)}): name all tags"
        )

    def _summed(self, here: Activation, components: int, add: Callable[[Array], None]) -> Array:
        """Sums at the nodes, on all ranks that know them, shape (nodes, components). Collective."""
        sums = Nodal([here.fields[0].basis.nodes], [components])
        add(sums.arrays[0])
        sums.add_up()
        sums.spread()
        return sums.arrays[0].copy()

    @stages.assemble
    def _at_nodes(self, s: Stencils, here: Activation) -> BodyAtNodes:
        """Mass, volume and normal of a body. Collective."""
        points, d = self._problem.points, self._problem.points.gdim
        m = point_masses(points)
        both = np.column_stack([m, points["V"]])
        sums = self._summed(here, 2, lambda out: scatter(s, np.ones(len(m)), both, out))
        weights = m[:, None, None] * np.eye(d)
        slope = self._summed(here, d, lambda out: scatter_stress(s, weights, out))
        return BodyAtNodes(self._settings.scaling * sums[:, 0], sums[:, 1], slope)

    def _room(self, here: Activation) -> Array:
        """Integrals of the nodes' functions (m^d), shape (nodes,)."""
        basis = here.fields[0].basis
        assert isinstance(basis, LatticeBasis)
        room = np.ones(basis.nodes.size)
        for k, line in enumerate(basis.lattice.lines):
            room *= integrals(line, basis.degree)[basis.halo.node_ijk[:, k]]
        return room

    def _hold(self, velocities: Sequence[Array], here: Activation, held: Array) -> None:
        """Give held components their velocities, and let sides of the grid rub."""
        faces, fixed = self._sides.on(here.fields[0].basis), here.unknowns.fields[0].fixed
        for V in velocities:
            if faces is not None:
                faces.rub(V)
            V[fixed] = held[fixed]

    @stages.assemble
    def _velocity(
        self, s: Stencils, body: BodyAtNodes, here: Activation, held: Array, v: Array
    ) -> Array:
        """Velocities of a body's nodes from those of its points (m/s). Collective."""
        m = self._settings.scaling * point_masses(self._problem.points)
        p = self._summed(here, v.shape[1], lambda out: scatter(s, m, v, out))
        V = p / np.where(body.mass > 0.0, body.mass, np.inf)[:, None]
        self._hold([V], here, held)
        return V

    @stages.assemble
    def _driven(
        self, s: Stencils, body: BodyAtNodes, V: Array, here: Activation, held: Array, dt: float
    ) -> Array:
        """Velocities of a body's nodes after a step in which no other acts on it. Collective."""
        points, loads = self._problem.points, self._loads
        weight = points["V"].copy()
        for declaration in self._problem.form.parts.declarations:
            if declaration.strain == "small":
                weight[declaration.rows] = points["V0"][declaration.rows]

        def add(out: Array) -> None:
            scatter_tensor(points, s, -weight[:, None, None] * points["stress"], out)
            if loads.uniform:
                given = np.broadcast_to(loads.gravity, (len(points), points.gdim))
                scatter(s, point_masses(points), given, out)
            else:
                scatter(s, np.ones(len(points)), loads.body, out)

        f = self._summed(here, points.gdim, add)
        damping = self._settings.damping
        if damping:
            f -= damping * np.abs(f) * np.sign(V)
        after = V + dt * f / np.where(body.mass > 0.0, body.mass, np.inf)[:, None]
        self._hold([after], here, held)
        return after

    def _points(
        self,
        stencils: Sequence[Stencils],
        rows: Sequence[Rows],
        before: Sequence[Array],
        after: Sequence[Array],
        dt: float,
    ) -> tuple[dict[str, Array], Array]:
        """New velocities, accelerations and positions of the points."""
        points, mapping = self._problem.points, self._settings.mapping
        share = mapping.share if mapping.kind == "flip" else 0.0
        v, a, x = points["velocity"].copy(), np.zeros_like(points["x"]), points["x"].copy()
        for s, own, V, V_end in zip(stencils, rows, before, after):
            change, there = (
                _at_points(s, values, len(points))[own] for values in (V_end - V, V_end)
            )
            v[own] = share * (v[own] + change) + (1.0 - share) * there
            a[own] = change / dt
            x[own] += dt * there
        return {"velocity": v, "acceleration": a}, x

    @staticmethod
    def _place(operator: Operator, rows: Sequence[Rows], increments: Sequence[Array]) -> None:
        """Evaluate at each point the increments of its own body."""
        value, gradient = operator.points.value[0], operator.points.gradient[0]
        found = np.zeros_like(value), np.zeros_like(gradient)
        for own, u in zip(rows, increments):
            operator.place([u])
            found[0][own], found[1][own] = value[own], gradient[own]
        value[:], gradient[:] = found

    def _external(self, moved: Array) -> float:
        """Work of the loads in a step (J). Collective."""
        points, loads = self._problem.points, self._loads
        way = moved - points["x"]
        f = loads.body
        if loads.uniform:
            f = point_masses(points)[:, None] * loads.gravity
        return points.comm.allreduce(float(np.sum(f * way)), op=MPI.SUM)


def _at_points(s: Stencils, values: Array, count: int) -> Array:
    """Nodal values at the points of a body among so many, shape (count, d); 0 at others."""
    d = s.dN.shape[1]
    found, slope = np.zeros((count, values.shape[1])), np.empty((count, values.shape[1], d))
    gather(s, values, found, slope)
    return found
