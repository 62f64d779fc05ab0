# %% [markdown]
# # UMATs: how many points per second
#
# Every point strains by a random increment, so that the von Mises law of demos/umat/mises.f yields
# almost everywhere. Four figures count: calls of the subroutine alone, which computes stress and
# DDSDDE; the flux with its tangent, as a Newton iteration needs it; and the flux alone. Explicit
# steps of a block that shears and turns count as a fourth. The built-in law under Jaumann's rate is
# measured in turn with it. What counts is the time of this process, and medians are told, since the
# machine may have other work.

# %%
from __future__ import annotations

import statistics
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import ufl
from mpi4py import MPI
from options import Options, natural, option
from scene import finish, say

import dolfinmpm as mpm
from dolfinmpm.forms.operators import KeptTangents
from dolfinmpm.kinematics import strain_formulation
from dolfinmpm.materials.umatshim import OFFSETS

FOLDER = Path(__file__).resolve().parents[1] / "umat"
E, NU, YIELD, HARDENING = 50e6, 0.3, 50e3, 1e6
CHUNK = 4096  # points at a time, as in a problem


@dataclass
class Input(Options):
    """Points per second of a UMAT and of the built-in law."""

    dimension: int = option(2, choices=(2, 3))
    points: int = natural(40_000, "about so many")
    repeat: int = natural(7)
    steps: int = natural(20, "explicit steps in each run that is timed")


args = Input.parse()
d = args.dimension
cells = max(1, round(args.points ** (1 / d) / 2))
grid = mpm.create_lattice(MPI.COMM_SELF, [range(cells + 1)] * d)
umat = mpm.materials.UMAT(FOLDER / "mises.f", [E, NU, YIELD, HARDENING], ["plastic_strain"])
own = mpm.materials.VonMises(E, NU, yield_stress=YIELD, hardening=HARDENING)
formulations = {}
for name, law in (("umat", umat), ("built-in", own)):
    points = mpm.fill(grid, mpm.Box((0,) * d, (cells,) * d), 2, 1.0)
    formulations[name] = strain_formulation(law, points, "jaumann")
    formulations[name].bind()
n, m = len(points), 6 if d == 3 else 4
H = 1e-2 * np.random.default_rng(0).uniform(-1, 1, (n, d * d))
rows = np.arange(n, dtype=np.int32)
work = umat.work(np.zeros((CHUNK, m)), np.zeros((CHUNK, 1)), m)
at = OFFSETS["dstran"]
work[:, at : at + m] = 1e-2 * np.random.default_rng(1).uniform(-1, 1, (CHUNK, m))


def sweep(formulation, sloping):
    for first in range(0, n, CHUNK):
        r = rows[first : first + CHUNK]
        S, A = np.empty((len(r), d * d)), np.empty((len(r), d * d, d * d)) if sloping else None
        kept = None if sloping else KeptTangents(np.empty((len(r), formulation.keeps)), False)
        assert formulation.evaluate(H[r], S, A, r, kept) == -1


def calls():
    for _ in range(max(1, n // CHUNK)):
        umat.call(work.copy(), m)


def swirl(x):
    """Velocities that strain and turn everywhere (m/s)."""
    return 20.0 * np.sin(6.0 * np.roll(x, 1, axis=1) / cells)


class Marching:
    """Explicit steps of a block in the middle of a grid."""

    def __init__(self, law):
        around = mpm.create_lattice(MPI.COMM_SELF, [range(-10, cells + 11)] * d)
        block = mpm.fill(around, mpm.Box((0,) * d, (cells,) * d), 2, 1000.0)
        V = mpm.Space(around, "bspline2")
        F = mpm.momentum(law, block, V.increment, V.test, strain="jaumann")
        F -= (
            ufl.inner(block.density * ufl.as_vector((0.0,) * (d - 1) + (-10.0,)), V.test) * block.dX
        )
        block.add_field("velocity", (d,), "m/s")
        block["velocity"] = swirl(block["x"])
        self.problem = mpm.Explicit(F, V.increment, block, scheme="usl", courant=0.3)
        self.longest, self.parts = 0.3 * self.problem.critical_step(), 0

    def __call__(self):
        """Take the steps of a run that is timed."""
        span = (args.steps - 0.01) * self.longest
        self.parts = self.problem.step(self.problem.time + span).parts


marching = {name: Marching(law) for name, law in (("umat", umat), ("built-in", own))}
cases = {"umat, call": calls}
for name, formulation in formulations.items():
    cases[f"{name}, flux"] = lambda f=formulation: sweep(f, False)
    cases[f"{name}, flux and tangent"] = lambda f=formulation: sweep(f, True)
    cases[f"{name}, explicit steps"] = marching[name]
taken = {name: [] for name in cases}
for k in range(args.repeat + 1):
    for name, case in cases.items():
        began = time.process_time()
        case()
        if k:  # the first round compiles
            taken[name].append(time.process_time() - began)
counts = dict.fromkeys(cases, n) | {"umat, call": max(1, n // CHUNK) * CHUNK}
for name, run in marching.items():
    counts[f"{name}, explicit steps"] = run.parts * len(run.problem.points)
speeds = {name: counts[name] / statistics.median(t) for name, t in taken.items()}
for name, speed in speeds.items():
    say(f"{name:28s} {speed / 1e6:6.2f} million points per second")
finish(args, speeds)
