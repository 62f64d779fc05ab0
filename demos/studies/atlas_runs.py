"""One problem of the stability atlas, from its seed to its outcome."""

from __future__ import annotations

import contextlib
import itertools
import signal
import time
import warnings
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import atlas_bodies
import atlas_explicit
import atlas_impacts
import atlas_slopes
import atlas_water
import numpy as np
from atlas_checks import Checks
from atlas_example import Example
from mpi4py import MPI

import dolfinmpm as mpm

__all__ = ["END", "FAMILIES", "TOLD", "WRONG", "Name", "differs", "names", "run"]

END, TOLD, WRONG = "to the end", "told why", "wrong"
FAMILIES: dict[str, Any] = {
    "slopes": atlas_slopes, "bodies": atlas_bodies, "impacts": atlas_impacts,
    "explicit": atlas_explicit, "water": atlas_water,
}  # fmt: skip
ITERATIONS = 40  # per step, over a whole run, before it is given up
GUARD = 120.0  # s


class Guard(Exception):
    """The clock's guard has ended a run."""


@dataclass(frozen=True)
class Name:
    """What names a problem, and all that it hangs on."""

    family: str
    basis: str
    stabilisation: str
    seed: int

    @property
    def command(self) -> str:
        """The command that repeats it alone."""
        return (
            f"python3 demos/studies/stability_atlas.py --seed {self.seed} --family {self.family} "
            f"--basis {self.basis} --stabilisation {self.stabilisation}"
        )


def names(families: Any, bases: Any, stabilisations: Any, seeds: Any) -> list[Name]:
    """All problems, seed by seed, in the order in which they are run."""
    cells = [
        (family, basis, kind)
        for family, basis, kind in itertools.product(families, bases, stabilisations)
        if basis in FAMILIES[family].BASES and kind not in getattr(FAMILIES[family], "WITHOUT", ())
    ]
    found = []
    for seed in seeds:
        # ranks take every other problem: each must get some of all kinds
        order = np.random.default_rng(seed).permutation(len(cells))
        found += [Name(*cells[k], seed) for k in order]
    return found


@contextlib.contextmanager
def guarded(comm: MPI.Comm) -> Iterator[None]:
    """End a run that the clock finds too long. Ranks together would not stop at one place."""
    if comm.size > 1:
        yield
        return

    def ring(*_: Any) -> None:
        raise Guard

    old = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, GUARD)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, old)


def run(name: Name, comm: MPI.Comm) -> dict[str, Any]:
    """Take all steps of a problem; returns its name, its outcome and its figures. Collective."""
    started, outcome, reason = time.perf_counter(), END, ""
    example = checks = None
    try:
        with guarded(comm), warnings.catch_warnings():
            warnings.simplefilter("ignore", mpm.errors.DolfinMPMWarning)
            family = FAMILIES[name.family]
            example = family.build(family.draw(name.seed), name.basis, name.stabilisation, comm)
            checks = Checks(example)
            outcome, reason = follow(example, checks)
    except mpm.errors.DolfinMPMError as error:
        outcome, reason = TOLD, f"{type(error).__name__}: {error}"
    except Guard:
        outcome, reason = TOLD, f"time: more than {GUARD:g} s"
    except Exception as error:
        # an error without a name tells the user nothing
        outcome, reason = WRONG, f"{type(error).__name__}: {error}"
        if time.perf_counter() - started > GUARD:
            outcome, reason = TOLD, f"time: more than {GUARD:g} s"
    figures = {} if example is None else figures_of(example)
    figures |= {} if checks is None else {"energy_made": checks.made}
    seconds = time.perf_counter() - started
    return {**asdict(name), "outcome": outcome, "reason": reason[:300], **figures,
            "seconds": seconds}  # fmt: skip


def follow(example: Example, checks: Checks) -> tuple[str, str]:
    """Take the steps, and look at each; returns the outcome and why. Collective."""
    history = example.problem.history
    most = ITERATIONS * example.steps
    for k in range(1, example.steps + 1):
        example.go(k)
        if not checks.step():
            return WRONG, f"step {k}: {checks.found}"
        if sum(getattr(record, "iterations", 0) for record in history) > most:
            return TOLD, f"iterations: more than {most} until step {k}"
    return (END, "") if checks.end() else (WRONG, f"at the end: {checks.found}")


def figures_of(example: Example) -> dict[str, Any]:
    """Counts of the steps, and figures that must not hang on the number of ranks. Collective."""
    problem, points = example.problem, example.problem.points
    history, comm = problem.history, points.comm
    moved = np.linalg.norm(points["x"] - points["x0"], axis=1)
    mass = points["density"] * points["V0"]
    total = comm.allreduce(np.array([mass.sum(), mass @ moved]))
    return {
        "steps": example.steps,
        "steps_done": len(history),
        "iterations": sum(getattr(record, "iterations", 0) for record in history),
        "halvings": sum(getattr(record, "halvings", 0) for record in history),
        "points": points.total,
        "moved": float(comm.allreduce(moved.max(initial=0.0), op=MPI.MAX)),
        "mean_moved": float(total[1] / total[0]),
        "size": example.size,
        "equal": example.equal,
    }


def differs(one: dict[str, Any], other: dict[str, Any]) -> str:
    """What two runs of one problem do not have in common, or ""."""
    if one["outcome"] != other["outcome"]:
        return f"{one['outcome']} or {other['outcome']}"
    apart = abs(one["mean_moved"] - other["mean_moved"])
    if apart > one["equal"] * max(one["mean_moved"], 1e-3 * one["size"]):
        return f"mean displacement {one['mean_moved']:.8g} or {other['mean_moved']:.8g} m"
    return ""
