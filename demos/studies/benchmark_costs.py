"""What parts cost: whole cases of the column, stabilisations, laws, facets of the ghost penalty."""

from __future__ import annotations

import contextlib
import cProfile
import gc
import pstats
import statistics
import time
from pathlib import Path

import numpy as np
from benchmark_scenes import compaction
from grids import box_grid
from scene import say

import dolfinmpm as mpm

STABILISATIONS = ("none", "ghost", "aggregation", "weak-aggregation", "extended", "soft")
# where all of their own work is done
MODULES = {"stabilisations.py", "penalties.py", "aggregation.py", "fractions.py", "prolongation.py"}


def column(columns, elements, basis, ghost=None, steps=40, stabilisation="none", profile=None):
    """Solve the column; returns seconds, Newton iterations and points."""
    problem, gravity = compaction(
        columns, elements, basis, stabilisation=stabilisation, ghost=ghost
    )
    # what measures stages is no part of a step
    mpm.measure_stages(False)
    started = time.perf_counter()
    with profile or contextlib.nullcontext():
        for k in range(steps):
            gravity.value[1] = -10.0 * (k + 1) / steps
            problem.step()
    seconds = time.perf_counter() - started
    mpm.measure_stages()
    return seconds, sum(record.iterations for record in problem.history), problem.points.total


def stabilisation_calls(columns, elements, basis, stabilisation, steps=40):
    """Python-level calls a step: of the stabilisations' code, and of everything."""
    profile = cProfile.Profile()
    column(columns, elements, basis, steps=steps, stabilisation=stabilisation, profile=profile)
    stats = pstats.Stats(profile)
    package = Path(mpm.__file__).parent
    own = 0
    for (path, _, name), (_, calls, *_) in stats.stats.items():
        path = Path(path)
        facets = path.name == "active.py" and name in ("select", "active_cells")
        if path.parent.parent == package and (path.name in MODULES or facets):
            own += calls
    return own / steps, stats.total_calls / steps


def memory(kind):
    """Resident memory of this process (kB), now ("VmRSS") or at its most ("VmHWM")."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(kind))


def time_cases(args):
    """Seconds and memory of the column in several sizes, by basis and size."""
    ghost = None if args.ghost == "none" else args.ghost
    figures: dict[str, dict] = {}
    for basis in args.bases.split(",") if args.cases else ():
        column(1, 16, basis, ghost)  # compiles, or loads what was compiled before
        for case in args.cases.split(","):
            columns, elements = (int(n) for n in case.split("x"))
            gc.collect()
            before = memory("VmRSS")
            # from here on the peak is counted anew
            Path("/proc/self/clear_refs").write_text("5")
            runs = [column(columns, elements, basis, ghost)]
            most = memory("VmHWM")
            for _ in range(args.repeat - 1):
                gc.collect()
                runs.append(column(columns, elements, basis, ghost))
            seconds = statistics.median(run[0] for run in runs)
            _, iterations, points = runs[0]
            figures[f"{basis} {case}"] = {
                "seconds": seconds,
                "seconds_least": min(run[0] for run in runs),
                "seconds_most": max(run[0] for run in runs),
                "newton_iterations": iterations,
                "points": points,
                "microseconds_per_point_and_iteration": 1e6 * seconds / points / iterations,
                "bytes_per_point": 1024 * (most - before) / points,
            }
            f = figures[f"{basis} {case}"]
            say(
                f"{basis:7s} {case:>7s}: {seconds:7.3f} s ({f['seconds_least']:.3f} to "
                f"{f['seconds_most']:.3f}), {iterations} iterations, "
                f"{f['microseconds_per_point_and_iteration']:.2f} µs per point and iteration, "
                f"{f['bytes_per_point']:.0f} bytes per point"
            )
    return figures


def time_stabilisations(args):
    """What stabilisations cost; runs of all take turns, so that what else goes on meets all."""
    stabilisations = (
        STABILISATIONS if args.stabilisations == "all" else (args.stabilisations or "").split(",")
    )
    costs: dict[str, dict] = {}
    for basis in args.bases.split(",") if args.stabilisations else ():
        for case in args.cases.split(","):
            columns, elements = (int(n) for n in case.split("x"))
            calls = {
                r: stabilisation_calls(columns, elements, basis, r) for r in stabilisations
            }  # compiles
            timed: dict[str, list] = {stabilisation: [] for stabilisation in stabilisations}
            for _ in range(args.repeat):
                for stabilisation in stabilisations:
                    timed[stabilisation].append(
                        column(columns, elements, basis, stabilisation=stabilisation)
                    )
            for stabilisation in stabilisations:
                iterations = timed[stabilisation][0][1]
                each = [1e3 * seconds / iterations for seconds, *_ in timed[stabilisation]]
                own, every = calls[stabilisation]
                costs[f"{basis} {case} {stabilisation}"] = {
                    "milliseconds_per_iteration": statistics.median(each),
                    "milliseconds_per_iteration_least": min(each),
                    "newton_iterations": iterations,
                    "stabilisation_calls_per_step": own,
                    "calls_per_step": every,
                }
                say(
                    f"{basis:7s} {case:>7s} {stabilisation:17s} {statistics.median(each):7.3f} ms "
                    f"iteration (least {min(each):.3f}), {iterations} iterations, {own:g} calls of "
                    f"stabilisations a step of {every:.0f}"
                )
    return costs


def time_laws(args):
    """Million points a second of each law, all of which yield, with its tangent."""
    laws: dict[str, float] = {}
    if args.laws:
        strains = np.random.default_rng(1).uniform(-0.05, 0.05, (1_000_000, 3))
        materials = mpm.materials
        elastic = {"E": 1e6, "nu": 0.3}
        for name, law, shift in (
            ("von Mises", materials.VonMises(**elastic, radius=1e3), 0.0),
            ("Tresca", materials.Tresca(**elastic, cohesion=1e3), 0.0),
            (
                "Mohr–Coulomb",
                materials.MohrCoulomb(**elastic, cohesion=1e3, friction_angle=30),
                -0.02,
            ),
            (
                "Drucker–Prager",
                materials.DruckerPrager(
                    **elastic, cohesion=1e3, friction_angle=30, dilation_angle=0
                ),
                -0.02,
            ),
            (
                "Cam-Clay",
                materials.CamClay(
                    swelling=0.018, compression=0.13, M=1.05, mu0=5.4e6, alpha=0.0,
                    reference_pressure=20e3, preconsolidation=20e3,
                ),
                -0.02,
            ),
        ):  # fmt: skip
            law.respond(strains[:10] + shift)
            seconds = []
            for _ in range(args.repeat):
                started = time.perf_counter()
                response = law.respond(strains + shift)
                seconds.append(time.perf_counter() - started)
            yielding = np.mean(np.any(response.strain != strains + shift, axis=1))
            laws[name] = 1e-6 * len(strains) / statistics.median(seconds)
            say(f"{name:14s} {laws[name]:6.2f} million points per second, {yielding:.0%} yield")
    return laws


def time_facets(args):
    """Assembly of the ghost penalty (µs per facet), reduced to the solver's unknowns.

    The body is chequered and has more ghost facets than any real one.
    """
    facets: dict[str, float] = {}
    for basis in args.bases.split(",") if args.facets else ():
        grid = box_grid([(0, 0), (200, 200)], (200, 200))
        body = mpm.Where(lambda x: ((x[0] // 4 + x[1] // 4) % 2 == 0) & (x.max(axis=0) < 199))
        points = mpm.fill(grid, body, 2, 1.0)
        V = mpm.Space(grid, basis)
        F = mpm.momentum(mpm.materials.Hencky(E=1.0, nu=0.3), points, V.increment, V.test)
        problem = mpm.QuasiStatic(F, V.increment, points, stabilisation="ghost")
        number, seconds = 0, []
        here = problem.activate()
        number = here.ghost_facets
        for _ in range(args.repeat):
            started = time.perf_counter()
            problem.form.grid.tangent(here.fields)
            seconds.append(time.perf_counter() - started)
        facets[basis] = 1e6 * statistics.median(seconds) / number
        say(f"{basis:9s} ghost penalty {facets[basis]:.2f} µs per facet ({number} facets)")
    return facets
