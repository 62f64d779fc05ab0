"""What all studies share: how they print, draw and hand over their figures."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI
from options import Options, command_line, values

import dolfinmpm as mpm


def parser(description: str) -> argparse.ArgumentParser:
    """A command line with the options that every study takes."""
    return command_line(Options, description)


def numbers(kind: type) -> Any:
    """A list of numbers on the command line, by commas."""
    return values(kind)


def stabilisation(kind: str, **options: Any) -> mpm.Stabilisation:
    """A stabilisation from the command line, with those of the options that it makes use of."""
    taken = ("E", "nu", *mpm.Stabilisation.takes(kind))
    return mpm.Stabilisation(kind, **{k: v for k, v in options.items() if k in taken})


def finish(arguments: Any, figures: dict[str, Any]) -> None:
    """Write the inputs and the figures where `--json` asks for them; on rank 0."""
    if arguments.json is None or MPI.COMM_WORLD.rank != 0:
        return
    inputs = {
        name: str(value) if isinstance(value, Path) else value
        for name, value in vars(arguments).items()
        if name not in ("json", "no_plot", "output")
    }
    text = json.dumps({**inputs, **figures})
    if arguments.json == "-":
        sys.stdout.flush()
        print(text, flush=True)
    else:
        Path(arguments.json).write_text(text + "\n")


def solver_figures(problem: Any) -> dict[str, Any]:
    """What the steps of a problem took, for the figures of a study. Collective."""
    history = problem.history
    iterations = [record.iterations for record in history]
    return {
        "newton_iterations": sum(iterations),
        "max_newton_iterations": max(iterations, default=0),
        "halvings": sum(record.halvings for record in history),
        "last_residuals": history[-1].residuals if history else [],
        "points": problem.points.total,
        # explicit steps may do without an activation
        "active_cells": problem.here.active_cells if problem.here is not None else None,
        "unknowns": history[-1].unknowns if history else 0,
        "migrated": sum(record.migrated for record in history),
        "imbalance": max((record.imbalance for record in history), default=1.0),
        "ranks": problem.comm.size,
        "stages": stage_seconds(problem),
    }


def stage_seconds(*problems: Any) -> dict[str, float]:
    """Seconds of each stage of all steps of some problems, of this rank."""
    records = [record for problem in problems for record in problem.history]
    names = records[0].stages if records else ()
    return {name: sum(record.stages[name] for record in records) for name in names}


def say(*words: Any) -> None:
    """Print on rank 0."""
    if MPI.COMM_WORLD.rank == 0:
        print(*words, flush=True)


def faces(points: Any, inside: Any, width: float) -> list[Any]:
    """The level and the upright part of the surface, a stair of the points' domains."""
    found = []
    for axis, name in ((1, "level"), (0, "upright")):
        n, half = np.eye(2)[axis], points["l0"]
        beyond = points["x0"] + 2 * half * n
        free = ~inside(beyond.T) & (beyond[:, 0] < width)
        offset = np.where(free[:, None], half * n, 0.0)
        area = np.where(free, 2 * half[:, 1 - axis], 0.0)[:, None] * n
        found.append(mpm.Surface.from_arrays(points, offset, area, name=name))
    return found


def fibre_stress(F: Any, stress: Any) -> Any:
    """Stress t·σt along the fibres t = F e_x/|F e_x| of a beam, shape (n,).

    Args:
        F: Deformation gradients, shape (n, 2, 2).
        stress: Cauchy stress (Pa), shape (n, 3, 3).
    """
    t = F[:, :, 0] / np.linalg.norm(F[:, :, 0], axis=1, keepdims=True)
    return np.einsum("pi,pij,pj->p", t, stress[:, :2, :2], t)


def outline_of_beam(x0: Any, x: Any, F: Any, l0: Any) -> Any:
    """Corners of the lowest and the highest row of a beam's points (m), from the support and back.

    Args:
        x0, x: First and present positions (m), shape (n, 2).
        F: Deformation gradients, shape (n, 2, 2).
        l0: First half-lengths (m), shape (n, 2).
    """
    rows = []
    for y, side in ((x0[:, 1].min(), -1), (x0[:, 1].max(), 1)):
        row = np.flatnonzero(np.isclose(x0[:, 1], y))
        row = row[np.argsort(x0[row, 0])]
        ends = np.array([(-1, side), (1, side)])
        rows.append(x[row, None] + np.einsum("pij,cj,pj->pci", F[row], ends, l0[row]))
    return np.vstack([rows[0].reshape(-1, 2), rows[1].reshape(-1, 2)[::-1]])


def draw_points(axes: Any, x: Any, F: Any, l0: Any, values: Any, **look: Any) -> Any:
    """Draw the points' deformed first domains, coloured by values; returns the collection.

    Args:
        axes: Matplotlib axes.
        x: Positions (m), shape (n, 2).
        F: Deformation gradients, shape (n, 2, 2).
        l0: First half-lengths (m), shape (n, 2).
        values: What they are coloured by, shape (n,).
        look: Further arguments of Matplotlib's `PolyCollection`.
    """
    from matplotlib.collections import PolyCollection

    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    parts = x[:, None] + np.einsum("pij,cj,pj->pci", F, corners, l0)
    # smooth edges would let the paper shine through between neighbours
    look = {"linewidths": 0, "antialiased": False, "snap": False, "rasterized": True, **look}
    drawn = PolyCollection([*parts], array=values, **look)
    axes.add_collection(drawn)
    axes.set(aspect="equal", xlabel="$x$ (m)", ylabel="$y$ (m)")
    axes.grid(visible=False)
    return drawn
