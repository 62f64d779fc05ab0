"""What studies of bodies in motion share: which integrator, which mass, which mapping."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

import numpy as np

import dolfinmpm as mpm
from dolfinmpm.dynamics.nodalmass import Mass
from dolfinmpm.dynamics.transfer import moments

INTEGRATORS = ("newmark", "generalised-alpha", "explicit")
BASES = ("linear", "gimp", "bspline2", "bspline3")
MAPPINGS = ("pic", "flip", "accel", "apic", "tpic", "xpic", "fmpm")


def add_options(
    options: argparse.ArgumentParser, h: float | None, points_per_cell: int = 2
) -> None:
    """Add what all of them take to a command line, with these defaults."""
    options.add_argument("--h", type=float, default=h, help="size of the cells (m)")
    options.add_argument("--points-per-cell", type=int, default=points_per_cell)
    options.add_argument("--basis", choices=BASES, default="gimp")
    options.add_argument("--integrator", choices=INTEGRATORS, default="newmark")
    options.add_argument(
        "--rho-inf", type=float, default=1.0, help="of generalised-α; 1 is the midpoint rule"
    )
    options.add_argument(
        "--courant", type=float,
        help="c Δt/h, or in explicit steps the share of the critical one; by default what suits",
    )  # fmt: skip
    options.add_argument(
        "--mass", choices=("lumped", "consistent", "aggregated"), default="consistent",
        help="aggregated: lumped behind aggregation, which ties the nodes of ill-filled cells",
    )  # fmt: skip
    options.add_argument("--mapping", choices=MAPPINGS, help="by default what the solver takes")
    options.add_argument("--order", type=int, default=2, help="stages of xpic and fmpm")
    options.add_argument(
        "--stabilisation", choices=("none", "ghost", "aggregation", "weak-aggregation", "extended"),
        help="by default ghost with a consistent mass, aggregation with an aggregated one",
    )  # fmt: skip
    options.add_argument(
        "--ghost-mass", type=float, help="ghost penalty of a consistent mass, in units of ρ"
    )


def parse(
    options: argparse.ArgumentParser, courant: float = 1.0, share: float = 0.8
) -> argparse.Namespace:
    """The command line, with the length of steps that suits its integrator.

    Args:
        options: The command line with what `add_options` adds.
        courant: c Δt/h of implicit steps where none is given.
        share: Share of the critical step that explicit ones take where none is given.
    """
    given = options.parse_args()
    if given.courant is None:
        given.courant = share if given.integrator == "explicit" else courant
    return given


def problem_of(
    args: argparse.Namespace, form: Any, u: Any, points: Any, bcs: Any = (), **explicit: Any
) -> Any:
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


def times_of(args: argparse.Namespace, end: float, speed: float, label: str = "") -> Iterator[Any]:
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
    mapping_on(problem).to_grid(problem.points, field.stencils, x, momenta)
    (v,) = mass.solve(momenta, np.zeros_like(momenta.arrays[0])).arrays
    return v[field.nodes], x[field.nodes, : problem.points.gdim]


def total_energy(problem: Any) -> float:
    """Kinetic and stored energy of a body (J, a metre across). Collective."""
    now = problem.energies()
    return now.kinetic + now.strain
