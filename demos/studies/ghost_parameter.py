# %% [markdown]
# # The factor of a ghost penalty
#
# The penalty must be large enough for a cell that is almost empty, and small enough not to make
# the body stiff. The *local constant* C of two cells at a facet, one full and one empty, measures
# the first:
#
# $$ u\cdot K_\mathrm{cut}\,u \le C\,(u\cdot K_\mathrm{full}\,u + \gamma\, u\cdot J\,u). $$
#
# Three questions are asked. How does $C$ depend on the penalty and Poisson's ratio, with $\gamma$
# in units of Young's modulus $E$ and of the P-wave modulus $M = \lambda + 2\mu$, and with the
# default, which weights shear and change of volume of a jump by $2\mu$ and $\lambda$? Does
# `factor="adaptive"` meet its target under elastic tangents and under those of soil that yields?
# And what does the penalty do to the deflection of a cantilever few cells deep, whose cells are all
# cut or next to cut ones?

# %%
from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import ufl
from grids import box_grid
from mpi4py import MPI
from options import Options, option
from scene import finish, say

import dolfinmpm as mpm
from dolfinmpm.assembly.facetpenalties import (
    INTERVALS,
    by_ratio,
    isotropic,
    lattice_pair,
    local_constant,
)
from dolfinmpm.assembly.facettensors import FacetTensors, facet_moduli
from dolfinmpm.assembly.latticefacets import LatticeFacet
from dolfinmpm.cut.facetmoduli import bounded, isotropic_moduli
from dolfinmpm.materials.base import lame

# g = γ h²/(3 E), as the literature has it: E/30 is 1/90
FACTORS = (1 / 90, 1 / 9, 1 / 3, 1.0)
DEGREES = {"linear": 1, "bspline2": 2, "bspline3": 3}


@dataclass
class Input(Options):
    """Local constants, and the deflection of a cantilever, over the ghost penalty."""

    dimension: int = option(2, choices=(2, 3))
    basis: str = option("linear", choices=tuple(DEGREES))
    target: float = option(30.0, "of the adaptive penalty")
    poisson: list[float] = option([0.0, 0.3, 0.49, 0.495])
    depths: list[int] = option([2, 4, 8], "cells of a beam")
    factors: list[float] | None = option(None, "g of the beams; 1/9000 ... 100 by default")
    cut: float = option(0.3, "filled share of the beams' edges")

    def _check(self):
        self.fill(factors=[1 / 9000, 1 / 90, 1 / 9, 1 / 3, 1.0, 10.0, 100.0])


# %% [markdown]
# ## Two cells at a facet
#
# On a grid of unit squares or cubes, away from its edges.


# %%
def two_cells(basis, dimension):
    """The pair of cells with γ = 1 Pa, and the default penalties per Pa of G and of λ."""
    cells = (7,) * dimension
    grid = box_grid([(0,) * dimension, cells], cells, MPI.COMM_SELF)
    points = mpm.fill(grid, mpm.Box((0,) * dimension, (1,) * dimension), 1, 1.0)
    V = mpm.Space(grid, basis)
    lines = [np.arange(8.0)] * dimension
    place = LatticeFacet(lines, (3,) * dimension, 0, False)

    def pairs(**strength):
        form = mpm.ghost(points, V.increment, V.test, **strength)
        bilinear = ufl.derivative(form, V.increment, ufl.TrialFunction(V.function_space))
        bilinear = ufl.algorithms.expand_derivatives(bilinear)
        tensors = FacetTensors(bilinear, DEGREES[basis], dimension)
        found = [tensors(place, one) for one in facet_moduli(form) or [None]]
        return [lattice_pair(place, DEGREES[basis], tensor) for tensor in found]

    default = mpm.Stabilisation("ghost").factor_of(V.increment)
    return *pairs(gamma=1.0), [pair.J for pair in pairs(factor=default)]


def constant(pair, tangent, penalty):
    """C of the pair under a tangent."""
    first, second = pair.stiffness(tangent)
    return local_constant(first, second, penalty * pair.J)


def adaptive(pair, moduli, target):
    """The library's adaptive penalty for M and G (Pa)."""
    M, G = moduli
    kept = np.full((1, INTERVALS + 1), np.nan)
    kinds = np.zeros(1, int)
    return M * by_ratio(kept, np.array([G / M]), kinds, [lambda: pair], target)[0]


def elastic_constants(pair, args, by_G, by_lambda):
    """C under elasticity: fixed factors in units of E and M, the default, and the adaptive one."""
    rows = []
    for nu in args.poisson:
        lmbda, mu = lame(1.0, nu)
        M = lmbda + 2 * mu
        D = isotropic(M, mu, args.dimension)
        gamma = adaptive(pair, (M, mu), args.target)
        rows.append({
            "nu": nu,
            "by_E": [constant(pair, D, 3 * g) for g in FACTORS],
            "by_M": [constant(pair, D, 3 * g * M) for g in FACTORS],
            "by_law": local_constant(*pair.stiffness(D), mu * by_G + lmbda * by_lambda),
            "adaptive": constant(pair, D, gamma),
            "g": gamma / 3 / M,
        })  # fmt: skip
    return rows


# %% [markdown]
# ## Tangents of soil that yields
#
# Laws are asked at trial strains far beyond yield, in several directions. The facet stands at any
# angle to the principal axes. A tangent that is not symmetric, or not positive, has no
# energy: what counts is the positive part of the symmetric one.

# %%
LAWS = {
    "von Mises": mpm.materials.VonMises(E=1.0, nu=0.3, radius=1e-3),
    "von Mises, ν = .49": mpm.materials.VonMises(E=1.0, nu=0.49, radius=1e-3),
    "Tresca, ν = .49": mpm.materials.Tresca(E=1.0, nu=0.49, cohesion=5e-4),
    "Drucker-Prager, ψ = 0": mpm.materials.DruckerPrager(1.0, 0.3, 5e-4, 30.0, dilation_angle=0.0),
    "Drucker-Prager, ψ = φ": mpm.materials.DruckerPrager(1.0, 0.3, 5e-4, 30.0, dilation_angle=30.0),
    "Mohr-Coulomb, ψ = 0": mpm.materials.MohrCoulomb(E=1.0, nu=0.3, cohesion=5e-4,
                                                     friction_angle=30.0, dilation_angle=0.0),
    "Mohr-Coulomb, ψ = 10": mpm.materials.MohrCoulomb(E=1.0, nu=0.2, cohesion=5e-4,
                                                      friction_angle=40.0, dilation_angle=10.0),
}  # fmt: skip
# principal trial strains, compressed and sheared in the plane, in the plane and across it
SHEARED = {"plane shear": (1.0, -1.0, 0.0), "compression": (0.5, -1.0, 0.5),
           "extension": (1.0, -0.5, -0.5), "sideways": (0.0, -1.0, 1.0)}  # fmt: skip


def spatial_tangent(law, strain):
    """Tangent in three dimensions from principal trial strains and the law's answer (Pa)."""
    answer = law.respond(strain[None])
    a, tau = answer.tangent[0], answer.stress[0]
    D = np.zeros((3,) * 4)
    for i in range(3):
        for j in range(3):
            D[i, i, j, j] = a[i, j]
            if i != j:
                gap = strain[i] - strain[j]
                # where strains are equal, the limit
                G = 0.5 * ((tau[i] - tau[j]) / gap if gap else a[i, i] - a[i, j])
                D[i, j, i, j] = D[i, j, j, i] = G
    return D, answer


def turned(D, angle):
    """A tensor turned in the plane."""
    R = np.eye(3)
    c, s = np.cos(angle), np.sin(angle)
    R[:2, :2] = [[c, -s], [s, c]]
    return np.einsum("ia,jb,kc,ld,abcd->ijkl", R, R, R, R, D)


def positive(D):
    """The positive part of the symmetric part of a tangent."""
    d = D.shape[0]
    A = D.reshape(d * d, d * d)
    values, vectors = np.linalg.eigh(0.5 * (A + A.T))
    return ((vectors * np.maximum(values, 0.0)) @ vectors.T).reshape(D.shape)


def yielding_constants(pair, args):
    """C of the adaptive penalty under tangents of yielding soil."""
    rows, d = [], args.dimension
    for name, law in LAWS.items():
        lmbda, mu = lame(law.E, law.nu)
        elastic = np.array([[lmbda + 2 * mu, mu]])
        for path, direction in SHEARED.items():
            # under some pressure, with many times the strain of first yield
            strain = 1e-2 * np.array(direction) - (5e-4 if "-" in name else 0.0)
            D, answer = spatial_tangent(law, strain)
            yielded = bool(np.abs(answer.strain[0] - strain).max() > 1e-4)
            found = []
            for angle in np.linspace(0, np.pi / 2, 7):
                here = turned(D, angle)[:d, :d, :d, :d]
                moduli = bounded(isotropic_moduli(here[None]), elastic)[0]
                gamma = adaptive(pair, moduli, args.target)
                found.append(constant(pair, positive(here), gamma))
            share = float(moduli[0] / elastic[0, 0])
            rows.append({"law": name, "path": path, "yielded": yielded, "share_of_M": share,
                         "least": min(found), "most": max(found)})  # fmt: skip
    return rows


# %% [markdown]
# ## A cantilever few cells deep
#
# Ten times as long as deep, ν = 0.2, under a weight that bends it by little. The cells along its
# lower and upper edge are filled to a share. Deflections are told by that without a penalty, which
# the smallest factor stands for.


# %%
def deflection(depth, g, cut, **options):
    """Deflection of the free end (m)."""
    h = 1.0 / depth
    low = (1 - cut) * h
    cells = (10 * depth + 2, depth + 3)
    size = (cells[0] * h, cells[1] * h)
    grid = box_grid([(0, 0), size], cells)
    # whole cells between the cut ones, and one less of them in all
    points = mpm.fill(grid, mpm.Box((0, low + h), (10, low + h + 1.0)), 4, 1.0)
    V = mpm.Space(grid, "linear")
    u, v = V.increment, V.test
    E = 1.0
    law = mpm.materials.Hencky(E=E, nu=0.2)
    stabilisation = mpm.Stabilisation("ghost", factor=90 * g, E=E) if g is not None else None
    stabilisation = stabilisation or mpm.Stabilisation("ghost", **options)
    F = mpm.momentum(law, points, u, v, strain="small")
    F -= ufl.inner(ufl.as_vector((0.0, -1e-7)), v) * points.dX
    problem = mpm.QuasiStatic(F, u, points, mpm.fixed(V, "left"), stabilisation=stabilisation)
    problem.step()
    moved = points["x"] - points["x0"]
    end = points["x0"][:, 0] > 10 - h
    total = points.comm.allreduce(np.array([moved[end, 1].sum(), end.sum()]))
    return float(-total[0] / total[1])


args = Input.parse()
pair, by_moduli = two_cells(args.basis, args.dimension)
constants = elastic_constants(pair, args, *by_moduli)
for row in constants:
    say(
        f"ν = {row['nu']:.3f}: C in units of E {np.round(row['by_E'], 1).tolist()}, of M "
        f"{np.round(row['by_M'], 1).tolist()}, by the law {row['by_law']:.1f}, "
        f"adaptive {row['adaptive']:.1f} with g = {row['g']:.3g}"
    )
yielding = yielding_constants(pair, args)
for row in yielding:
    say(f"{row['law']}, {row['path']}: C {row['least']:.1f} ... {row['most']:.1f}, "
        f"M {row['share_of_M']:.2f} of the elastic one, yielded: {row['yielded']}")  # fmt: skip

beams = []
for depth in args.depths:
    found = [deflection(depth, g, args.cut) for g in args.factors]
    limit = found[0]
    default, hundredth = (deflection(depth, None, args.cut, factor=k) for k in (1.0, 0.01))
    own = deflection(depth, None, args.cut, factor="adaptive", target=args.target)
    beams.append({
        "depth": depth, "g": args.factors, "share": [w / limit for w in found],
        "default_by_hundredth": default / hundredth, "adaptive": own / limit,
    })  # fmt: skip
    say(
        f"{depth} cells deep: {np.round(beams[-1]['share'], 3).tolist()}, default over a hundredth "
        f"of it {default / hundredth:.4f}, adaptive {own / limit:.3f}"
    )

# %% [markdown]
# ## Picture

# %%
if not args.no_plot and MPI.COMM_WORLD.rank == 0:
    line = np.logspace(-3, 3, 49)
    with mpm.figure(args.output / "ghost_parameter.png", 10.0, 3.0, ncols=3) as (_, axes):
        left, middle, right = axes
        for k, row in enumerate(constants):
            lmbda, mu = lame(1.0, row["nu"])
            M = lmbda + 2 * mu
            D = isotropic(M, mu, args.dimension)
            color, label = f"C{k}", f"ν = {row['nu']:g}"
            left.loglog(line, [constant(pair, D, 3 * g) for g in line], ":", color=color)
            left.loglog(
                line, [constant(pair, D, 3 * g * M) for g in line], color=color, label=label
            )
            left.plot(row["g"], row["adaptive"], "o", color=color)
            left.plot(1 / 90, row["by_law"], "x", color=color)
        left.set(
            xlabel="g in units of M (dotted: E); ○ adaptive, × default",
            ylabel="local constant C",
        )
        left.legend()
        names = list(LAWS)
        for row in yielding:
            if not row["yielded"]:
                continue
            at = names.index(row["law"])
            middle.plot([at, at], [row["least"], row["most"]], "o-", color="C0", alpha=0.5)
        middle.axhspan(args.target / 2, args.target * 2, color="0.9")
        middle.axhline(args.target, color="k", linewidth=0.8)
        middle.set(ylabel="C of the adaptive penalty, yielding", ylim=(0, 2.2 * args.target))
        middle.set_xticks(range(len(names)), names, rotation=35, ha="right", fontsize=6)
        for k, beam in enumerate(beams):
            right.semilogx(
                beam["g"], beam["share"], "o-", color=f"C{k}", label=f"{beam['depth']} cells deep"
            )
        right.axvline(1 / 90, color="k", linewidth=0.8)
        right.set(xlabel="g in units of E (line: 1/90)", ylabel="deflection by the limit")
        right.legend()

worst = [max(args.target / r["least"], r["most"] / args.target) for r in yielding if r["yielded"]]
finish(args, {"constants": constants, "yielding": yielding, "worst_yielding": max(worst),
              "beams": beams, "ranks": MPI.COMM_WORLD.size})  # fmt: skip
