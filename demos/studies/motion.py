"""What studies of bodies in motion share: which integrator, which mass, which mapping."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from options import BASES, Options, natural, option, positive

import dolfinmpm as mpm
from dolfinmpm.dynamics.nodalmass import Mass
from dolfinmpm.dynamics.transfer import moments

INTEGRATORS = ("newmark", "generalised-alpha", "explicit")
MAPPINGS = ("pic", "flip", "accel", "apic", "tpic", "xpic", "fmpm")


@dataclass
class Moving(Options):
    """The options of studies of bodies in motion."""

    h: float | None = positive(None, "size of the cells (m)")
    points_per_cell: int = natural(2)
    basis: str = option("gimp", choices=BASES)
    integrator: str = option("newmark", choices=INTEGRATORS)
    rho_inf: float = option(1.0, "of generalised-α; 1 is the midpoint rule")
    courant: float | None = option(
        None, "c Δt/h, or in explicit steps the share of the critical one; by default what suits"
    )
    mass: str = option(
        "consistent",
        "aggregated: lumped behind aggregation, which ties the nodes of ill-filled cells",
        choices=("lumped", "consistent", "aggregated"),
    )
    mapping: str | None = option(None, "by default what the solver takes", choices=MAPPINGS)
    order: int = option(2, "stages of xpic and fmpm")
    stabilisation: str | None = option(
        None,
        "by default ghost with a consistent mass, aggregation with an aggregated one",
        choices=("none", "ghost", "aggregation", "weak-aggregation", "extended"),
    )
    ghost_mass: float | None = option(None, "ghost penalty of a consistent mass, in units of ρ")

    def _check(self) -> None:
        self.fill(courant=0.8 if self.integrator == "explicit" else 1.0)


def problem_of(args: Moving, form: Any, u: Any, points: Any, bcs: Any = (), **explicit: Any) -> Any:
    """The problem that the command line asks for, with further options of explicit steps."""
    usual = {"lumped": "none", "consistent": "ghost", "aggregated": "aggregation"}
    stages = {"order": args.order} if args.mapping in ("xpic", "fmpm") else {}
    mapping = None if args.mapping is None else mpm.Mapping(args.mapping, **stages)
    options: dict[str, Any] = {
        "mass": "consistent" if args.mass == "consistent" else "lumped",
        "mapping": mapping,
        "ghost_mass": args.ghost_mass,
        "stabilisation": args.stabilisation or usual[args.mass],
    }
    if args.integrator == "newmark":
        return mpm.Newmark(form, u, points, bcs, **options)
    if args.integrator == "generalised-alpha":
        return mpm.GeneralisedAlpha(form, u, points, bcs, rho_inf=args.rho_inf, **options)
    return mpm.Explicit(form, u, points, bcs, courant=args.courant, **options, **explicit)


def times_of(args: Moving, end: float, speed: float, label: str = "") -> Iterator[Any]:
    """Times to step to (s): Courant's number of h/c, or what an explicit problem chooses."""
    dt = "auto" if args.integrator == "explicit" else args.courant * args.h / speed
    # figures are of every step
    return mpm.times(end, dt=dt, label=label, at_once=1)


def mapping_on(problem: Any) -> mpm.Mapping:
    """The velocity mapping that a problem goes by."""
    return problem.motion.mapping if hasattr(problem, "motion") else problem.mapping


def give_affine_part(problem: Any, gradient: Any) -> None:
    """Let points whose mapping has an affine part begin with it. Collective.

    Args:
        problem: The problem, before its first step.
        gradient: Gradient of the velocity (1/s), shape (d, d).
    """
    points, kind = problem.points, mapping_on(problem).kind
    if kind == "tpic":
        points["velocity_gradient"] = gradient
    if kind == "apic":
        field = problem.activate().fields[0]
        x, nodes = points["x"], field.basis.node_coordinates()[:, : points.gdim]
        points["velocity_moment"] = gradient @ moments(field.stencils, nodes, x, nodes, x)


def nodal_velocities(problem: Any) -> tuple[Any, Any]:
    """Velocities of the active nodes that the points would give now, and their places. Collective.

    Returns:
        Velocities (m/s) and positions (m), shape (n, d) each.
    """
    field = problem.activate().fields[0]
    mass, x = Mass(problem.terms, problem.here), field.basis.node_coordinates()
    momenta = mass.nodal()
    mapping_on(problem).to_grid(problem.points, field, x, momenta)
    (v,) = mass.solve(momenta, np.zeros_like(momenta.arrays[0])).arrays
    return v[field.nodes], x[field.nodes, : problem.points.gdim]


def total_energy(problem: Any) -> float:
    """Kinetic and stored energy of a body (J, a metre across). Collective."""
    now = problem.energies()
    return now.kinetic + now.strain
