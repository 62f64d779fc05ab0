# %% [markdown]
# # Time against error, and how both grow
#
# - **Work and precision** (`--scenes`): five scenes with a known result: a column that compacts
#   under its weight, a cantilever, a footing, sand that collapses, a ring that turns within
#   itself. They run in all bases, refinements, points per cell and stabilisations. The figures
#   are the processor time of the steps against the error, and the parts of the time of a step.
# - **Growth** (`--growth`): with points, with the grid around a body, and with ranks, for the
#   same work (strong) and for the same work per rank (weak), with the messages that PETSc sends.
#   Messages that Python or DOLFINx send by MPI themselves are not counted.
# - **Other codes** (`--peers`): Kratos on the column, in turn with this code, medians of five:
#   one element wide among the scenes, and with the sizes of the cases. If pip has put Kratos into
#   a folder of its own, the variable `PEERS` names this folder. For explicit steps see
#   `explicit_speed.py --peers`.
# - **Cases** (`--cases`): the column in 40 steps, one element wide and 64 high, and 16 wide and
#   256 high. Memory is the largest memory of the process less that of a small run, per point.
#   `--stabilisations all` solves each case with every stabilisation against small cuts, and
#   counts the calls of their code per step: an unused stabilisation costs one question per step,
#   whether any nodes follow others. `--laws` and `--facets` time parts. `--plastic 80` times
#   implicit steps of Mohr–Coulomb sand, stage by stage.
#
# `--quick` takes the smallest sizes of all, within a minute or two. Empty lists, as in `--scenes=`,
# leave parts out.

# %%
from __future__ import annotations

from dataclasses import dataclass

import benchmark_costs as costs
import benchmark_growth
import benchmark_peers
import benchmark_plastic
import benchmark_plots
import benchmark_scenes as scenes
from mpi4py import MPI
from options import Options, option
from scene import finish, say


def whole(text):
    """Whole numbers on the command line, by commas; 1e6 is one."""
    return [int(float(word)) for word in text.split(",") if word]


@dataclass
class Input(Options):
    """Time against error, growth, other codes, and times and memory of parts."""

    quick: bool = option(False, "small sizes, one run of each")
    repeat: int | None = option(None, "counted runs of each case; 5, and 3 of scenes")
    cases: str = option("1x64,16x256", "columns x elements, by commas")
    bases: str | None = option(
        None, "of cases gimp,linear by default; of scenes all that they have"
    )
    ghost: str = option("none", choices=("none", "literal", "scaled"))
    stabilisations: str | None = option(
        None, 'stabilisations to time against each other, by commas, or "all"; none by default'
    )
    laws: bool = option(False, "million points a second of each law")
    facets: bool = option(False, "assembly of the ghost penalty a facet")
    plastic: int = option(
        0,
        "a metre of a block of Mohr–Coulomb "
        "sand in implicit steps; 80 are 30 720 points; not run by default",
        metavar="CELLS",
    )
    scenes: list[str] = option(list(scenes.SCENES), "by commas", choices=tuple(scenes.SCENES))
    refinements: int | None = option(None, "of each scene, from the coarsest; all")
    densities: int | None = option(None, "numbers of points a cell of each scene; all")
    growth: list[str] = option(
        list(benchmark_growth.WITH), "with which, by commas", choices=benchmark_growth.WITH
    )
    explicit_points: list[int] = option([10**k for k in range(3, 8)], type=whole)
    implicit_points: list[int] = option(
        [10**k for k in range(3, 7)],
        "2 kB a point, factors or multigrid: 6 GB for the last",
        type=whole,
    )
    solid_points: list[int] = option(
        [160_000, 400_000, 1_000_000],
        "of cubes, implicit: 2 kB per point, 7 kB with GIMP",
        type=whole,
    )
    fixed_points: int = option(40_000, "of growth with cells, ranks")
    ranks: list[int] = option([1, 2, 4, 8], "more than processors too", type=whole)
    peers: bool = option(False, "Kratos on the column")

    def _check(self):
        if MPI.COMM_WORLD.size > 1:
            raise ValueError("it starts processes of its own: run it on one rank")


args = Input.parse()
bases = args.bases.split(",") if args.bases else None
given, args.bases = args.repeat, args.bases or "gimp,linear"
args.repeat = given or (1 if args.quick else 5)
if args.quick:
    args.explicit_points, args.implicit_points = [1_000, 10_000], [1_000, 4_000]
    args.solid_points, args.fixed_points, args.ranks = [1_000, 4_000], 2_000, [1, 2]
    if args.cases == Input.cases:
        args.cases = "1x16"

# %% [markdown]
# ## Cases, and parts

# %%
figures = {
    "cases": costs.time_cases(args),
    "stabilisations": costs.time_stabilisations(args),
    "laws": costs.time_laws(args),
    "facets": costs.time_facets(args),
    "plastic": benchmark_plastic.time_plastic(args),
}

# %% [markdown]
# ## Work and precision
# The coarsest run of a kind is taken once before: what compiles is not counted.

# %%
runs = scenes.runs_of(args.scenes, args.quick, bases, args.refinements, args.densities)
scenes.measure(runs, 1 if args.quick else given or 3)
peers = []
if args.peers:
    levels = (8, 16) if args.quick else (16, 32, 64, 128)
    levels = levels if "column" in args.scenes else ()
    peers = benchmark_peers.compare(levels, 1 if args.quick else max(5, args.repeat))
figures |= {"runs": [run.figures() for run in runs], "peers": peers}
figures["peer_cases"] = {}
if args.peers:
    sizes = args.cases.split(",") if args.cases else []
    figures["peer_cases"] = benchmark_peers.cases(sizes, args.repeat)

# %% [markdown]
# ## Growth
# Exponents are those of the last decade of sizes.

# %%
figures["growth"] = benchmark_growth.growth(args)

if not args.no_plot:
    done = [run for run in runs if run.error is not None]
    if done:
        benchmark_plots.work_precision(args.output / "benchmark_precision.png", runs, peers)
        benchmark_plots.stages(args.output / "benchmark_stages.png", runs)
    if figures["growth"]:
        benchmark_plots.growth(args.output / "benchmark_growth.png", figures["growth"])
    say(f"pictures in {args.output}")

finish(args, {**figures, "ranks": MPI.COMM_WORLD.size})
