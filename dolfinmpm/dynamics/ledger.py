"""The account of energies and works of a moving body, step by step.

Each step adds to sums: work of loads and of stresses, changes of the nodes' kinetic energy, and
named losses. The energies themselves are computed from the state on request. So are the losses
that are differences:

- "plastic": work of the stresses less the energy stored by laws that may yield;
- "projection": change of the nodes' kinetic energy less change of the points' kinetic energy: the
  loss by mapping from the points to the nodes and back. In explicit steps: the kinetic energy that
  the points would have if nodes only changed their velocities, less theirs; zero in "flip";
- "merging": kinetic and elastic energy that points lose where they split and merge, such as by
  `Problem.adapt`;
- "integrator": the remainder, such as damping by a rule in time or errors of quadrature.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import UnknownNameError
from dolfinmpm.body.energychanges import EnergyChanges
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.contact.rigidbodies import RigidBodies
from dolfinmpm.dynamics.energies import (
    angular_momentum,
    kinetic_energy,
    momentum_of,
)
from dolfinmpm.dynamics.worksums import LOSSES, Work
from dolfinmpm.solve.weakform import WeakForm

__all__ = ["Energies", "Ledger", "MovingBody"]

Array = npt.NDArray[np.float64]

# First values, from which changes are measured
_FIRST = ("kinetic", "strain", "bodies", "rubbed", "initial", "started")
# Relative change of a sum over the points by the order in which ranks add them up
_ROUNDING = 1e-12


@dataclass(frozen=True)
class Energies:
    """Energies of a body (J; per metre of thickness in 2D, of the whole body in axisymmetry).

    kinetic + bodies + strain + contact + dissipated − external = initial.

    Bodies in one velocity field, without `mpm.contact` or `Collision`, have one velocity at a
    common node. So their impact is perfectly inelastic within a cell. The loss counts as
    "projection". It counts as "integrator" if points keep velocities that nodes do not represent.

    Attributes:
        kinetic: ½ Σ m v² of the points. Velocities of explicit steps are half a step behind
            positions. So the kinetic energy is corrected to the time of the positions, see
            `dolfinmpm.dynamics.energies`. The same holds for free rigid bodies.
        strain: Elastic energy stored by the laws; NaN if a law has no energy.
        external: Work of loads and prescribed motions since the first step, of pressures that
            follow a `Surface` or a `Boundary`, too. Terms of your own over the points that depend
            on the increment are in "integrator".
        bodies: Kinetic energy of free rigid bodies.
        contact: Energy stored by the penalties of contacts and of walls (`signorini`).
        initial: Total energy before the first step, plus energy that the user gives between steps:
            by velocities, and with points that come or go.
        losses: Name → energy dissipated since the first step, see `dolfinmpm.dynamics.ledger`.
    """

    kinetic: float
    strain: float
    external: float
    bodies: float = 0.0
    contact: float = 0.0
    initial: float = 0.0
    losses: Mapping[str, float] = field(default_factory=dict)

    @property
    def dissipated(self) -> float:
        """The sum of the losses (J)."""
        return sum(self.losses.values())

    def __iter__(self) -> Iterator[str]:  # `in` and list() would count numbers from 0 without it
        return iter(self.losses)

    def __getitem__(self, name: str) -> float:
        """A loss by its name (J).

        Raises:
            UnknownNameError: There is no loss of this name.
        """
        if name not in self.losses:
            more = f"; take energies().{name}" if hasattr(self, name) else ""
            raise UnknownNameError(f"no loss is named '{name}'; there are {[*self.losses]}{more}")
        return self.losses[name]


class Ledger:
    """The energies of a problem in time.

    Args:
        points: Material points.
        form: The weak form.
        bodies: The rigid bodies of the form.
        mass_scaling: Factor of the points' mass in the inertia.
        by_points: Whether steps sum up the energy lost by the mapping, see `Work`.

    Attributes:
        work: Sums over the steps.
        came: Whether points have come or gone, which the motion takes back.
    """

    def __init__(
        self, points: MaterialPoints, form: WeakForm, bodies: RigidBodies,
        mass_scaling: float = 1.0, by_points: bool = False,
    ):  # fmt: skip
        self.work, self.came = Work(), False
        self._points, self._form, self._bodies = points, form, bodies
        self.mass_scaling, self._by_points = mass_scaling, by_points
        self._first = dict.fromkeys(_FIRST, 0.0)
        self._last = 0.0
        self._changes = EnergyChanges(points, self._own)

    def begin(self) -> None:
        """Record the energies before a step, or before a call with several steps. Collective.

        The first call records all first energies, later ones what the user has changed since then.
        """
        first, kinetic = self._first, self.kinetic()
        if not first["started"]:
            strain, touching = self._strain(), self._touching()
            first |= {
                "kinetic": kinetic, "strain": strain, "bodies": self._bodies.kinetic(),
                "rubbed": touching[1], "started": 1.0,
            }  # fmt: skip
            first["initial"] = kinetic + strain + first["bodies"] + touching[0]
            self._changes.taken()
        else:
            self._account(kinetic)
        self._last = kinetic

    def adapted(self) -> None:
        """Begin a step whose points the steps have split: not a change by the user. Collective."""
        by_user = self._bodies.by_user
        self.begin()
        self._bodies.by_user = by_user

    def _account(self, kinetic: float) -> None:
        """Account for what has changed between steps, to a kinetic energy (J). Collective."""
        first, (given, merged) = self._first, self._changes.taken()
        self.work.losses["merging"] -= float(merged[:2].sum())
        first["kinetic"] += float(merged[0])
        first["strain"] += float(merged[1] + given[1])
        first["initial"] += float(given[1] + given[2])
        self._bodies.stored += float(given[2])
        self.came |= bool(given[3] > 0.0)
        touches = bool(given[3] + merged[3] > 0.0)
        self._bodies.changed |= touches
        self._bodies.by_user |= touches
        self._last += float(merged[0])
        if self._set_by_user(kinetic):
            # changed velocities count as velocities at the present time
            first["kinetic"] += kinetic - self._last
            half = (self.work.half_step + self.work.start) / self.mass_scaling
            first["initial"] += kinetic - self._last - half
            self.work.half_step = self.work.start = 0.0
        self._last = kinetic

    def _set_by_user(self, kinetic: float) -> bool:
        """Whether velocities changed since the last step; a restart changes the last digits."""
        return not math.isclose(kinetic, self._last, rel_tol=_ROUNDING)

    @property
    def dissipated(self) -> float:
        """What laws with F-bar have dissipated (J); zero without such laws. Collective."""
        if not any(getattr(declaration, "fbar", False) for declaration in self._form.storing):
            return 0.0
        return self.energies().losses["plastic"]

    @property
    def started(self) -> bool:
        """Whether a step has begun."""
        return bool(self._first["started"])

    @property
    def whole(self) -> float:
        """First energy plus work of loads since the first step (J)."""
        return self._first["initial"] + (self._bodies.given or 0.0) + self.work.external

    def end(self) -> float:
        """Record the state after a step or a call; returns the kinetic energy (J). Collective."""
        self._last = self.kinetic()
        return self._last

    def kinetic(self) -> float:
        """½ Σ m v² of the points (J). Collective."""
        return float(self._points.comm.allreduce(kinetic_energy(self._points), op=MPI.SUM))

    def moving(self) -> float:
        """Kinetic energy of points, scaled, and of bodies, and that of contact (J). Collective."""
        bodies = self._bodies
        own = bodies.kinetic() + bodies.stored - (bodies.given or 0.0)
        return self.mass_scaling * self.end() + own

    def _touching(self) -> tuple[float, float]:
        """Energy stored by contact of facing bodies, and all work of friction (J). Collective."""
        energies = [term.energy() for term in self._form.terms]
        rubbed = self._bodies.friction_work + sum(rubbed for _, rubbed in energies)
        return sum(stored for stored, _ in energies), rubbed

    def _strain(self) -> float:
        """Elastic energy stored by the laws (J). Collective."""
        return float(self._points.comm.allreduce(self._own()[1], op=MPI.SUM))

    def _own(self) -> Array:
        """Kinetic, elastic and contact energy of the points of this rank (J), shape (3,)."""
        strain, V0 = 0.0, self._points.fields.read("V0")
        for declaration in self._form.storing:
            stored = declaration.energy()
            strain += math.nan if stored is None else float(stored @ V0[declaration.rows])
        return np.array([kinetic_energy(self._points), strain, self._bodies.stored_here()])

    def energies(self) -> Energies:
        """The present energies. Collective."""
        first, work = self._first, self.work
        own, strain = self.kinetic(), self._strain()
        if first["started"] and self._changes.found():
            self._account(own)
        # velocities changed by the user count as velocities at the present time
        half = 0.0 if self._set_by_user(own) else (work.half_step + work.start) / self.mass_scaling
        kinetic = own + half
        bodies, (contact, rubbed) = self._bodies.kinetic() + work.of_bodies, self._touching()
        contact += self._bodies.stored
        if not first["started"]:
            whole = kinetic + strain + bodies + contact
            names = ("plastic", "projection", *LOSSES, "integrator")
            losses = dict.fromkeys(names, 0.0)
            return Energies(kinetic, strain, 0.0, bodies, contact, whole, losses)
        losses = {"plastic": 0.0, "projection": 0.0, **work.losses}
        laws = [d.law for d in self._form.parts.declarations]
        if any(getattr(law, "strengths", ()) != () for law in laws):
            losses["plastic"] = work.internal - (strain - first["strain"])
        losses["friction"] += rubbed - first["rubbed"]
        gained = own - first["kinetic"]
        losses["projection"] = work.projected
        if not self._by_points:
            losses["projection"] = work.grid - self.mass_scaling * gained
        if self.mass_scaling != 1.0:
            # scaled inertia has more energy than the mass
            losses["mass scaling"] = (self.mass_scaling - 1.0) * (gained + half)
        known = kinetic + strain + bodies + contact + sum(losses.values())
        initial = first["initial"] + (self._bodies.given or 0.0)
        losses["integrator"] = self.whole - known
        return Energies(kinetic, strain, work.external, bodies, contact, initial, losses)

    def state(self) -> dict[str, Any]:
        """Its state from step to step. Collective."""
        if self.started and self._changes.found():
            self._account(self.kinetic())
        first = np.array([*self._first.values(), self._last])
        return {"work": self.work.values(), "first energies": first}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Restore a state returned by `state`."""
        self.work.take(state["work"])
        self._changes.taken()
        *first, self._last = (float(v) for v in state["first energies"])
        self._first = dict(zip(_FIRST, first))


class MovingBody:
    """Energies and momenta of a problem in time; a base of such problems.

    Attributes:
        points: Material points.
        ledger: The account of energies and works.
        mapping: The velocity mapping.
    """

    points: MaterialPoints
    ledger: Any
    mapping: Any

    @collective
    def energies(self) -> Energies:
        """Present energies of the body, and work done since the first step. Collective.

        The kinetic energy is at the time of the positions. In explicit steps this is half a step
        after the velocities. Where bodies meet in one velocity field, the mapping takes energy from
        them, see `Energies`.
        """
        return self.ledger.energies()

    @collective
    def momentum(self) -> Array:
        """Linear momentum of the body (kg m/s), shape (d,). Collective."""
        return momentum_of(self.points)

    @collective
    def angular_momentum(self) -> Array:
        """Angular momentum about the origin (kg m²/s), shape (1,) or in 3D (3,). Collective.

        With "apic", the points' affine velocities are included.
        """
        spins = self.mapping.kind == "apic"
        return angular_momentum(self.points, self.points["velocity_moment"] if spins else None)
