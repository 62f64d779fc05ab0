"""Scenes that give the same figures on any number of ranks; `run_case.py NAME` runs one."""

from __future__ import annotations

from . import (
    arguments,
    bodies,
    dynamics,
    explicit,
    failures,
    fbar,
    loads,
    plasticity,
    remedies,
    restart,
    tables,
    transport,
)

__all__ = ["CASES"]

# a case's name is that of its function, which returns its figures; it is collective
CASES = {
    case.__name__: case
    for case in (
        transport.column,
        transport.triangles,
        transport.carried_2d,
        transport.carried_3d,
        transport.stencils_across_corners,
        transport.tall,
        bodies.partitioned,
        bodies.in_a_corner,
        transport.two_fields,
        transport.driven,
        remedies.remedies_gimp,
        remedies.remedies_linear,
        remedies.remedies_triangles,
        remedies.remedies_bspline2,
        remedies.facets_of_few_ranks,
        remedies.adaptive_penalties,
        plasticity.large_strain,
        plasticity.small_strain,
        plasticity.jaumann,
        loads.surface_loads,
        loads.snap_through,
        fbar.fbar_bases,
        fbar.fbar_3d,
        fbar.fbar_triangles,
        fbar.fbar_ties,
        fbar.fbar_tangent,
        fbar.fbar_layers,
        plasticity.plastic,
        plasticity.law_in_ufl,
        bodies.points_from_data,
        bodies.numbers_of_points,
        bodies.staged,
        bodies.errors_of_bodies,
        plasticity.layers,
        plasticity.wall,
        failures.errors_on_all_ranks,
        arguments.bad_inputs,
        arguments.of_one_rank,
        arguments.of_few_cells,
        tables.tables,
        restart.restart_ghost,
        restart.restart_aggregation,
        restart.restart_triangles,
        restart.restart_splines,
        restart.restart_arch,
        restart.restart_errors,
        dynamics.dynamics,
        dynamics.dynamics_lumped,
        dynamics.dynamics_restart,
        explicit.explicit_steps,
        explicit.explicit_restart,
    )
}
