# %% [markdown]
# # A stability atlas: random problems, and how each of them ends
#
# Every problem is drawn from a seed: slopes that fail and slide, rigid bodies pressed into soil and
# dragged through it, bodies that collide, soil with water. All are run with every basis and every
# stabilisation that suits, and each ends in one of three ways:
#
# - **to the end**: all steps converged, and no check found anything;
# - **told why**: a named error of `mpm.errors` ended it, or it took more iterations than it may;
# - **wrong**: energy out of nothing, mass or volume lost, points inside a rigid body, a field that
#   is not finite, det F ≤ 0, stress beyond the yield surface, an error without a name, or other
#   figures on all ranks together than on one.
#
# The bounds of what is drawn stand in the families' modules, `atlas_slopes` and so on.
#
#     mpirun -n 2 python3 demos/studies/stability_atlas.py --seeds 12 --resume
#     python3 demos/studies/stability_atlas.py --seed 7 --family slopes --basis gimp
#
# Under mpirun every rank takes problems of its own; with `--ranks` all take each together. The
# results are appended to `stability_atlas.jsonl` as they come, one line each; `--resume` goes on
# from there.

# %%
from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import atlas_pictures
from atlas_runs import END, FAMILIES, TOLD, WRONG, Name, differs, names, run
from mpi4py import MPI
from scene import finish, numbers, parser, say

import dolfinmpm as mpm

WORLD = MPI.COMM_WORLD
BASES = "linear", "gimp", "bspline2", "bspline3"
STABILISATIONS = "none", "ghost", "aggregation"
OTHERS = "weak-aggregation", "extended", "soft"
KEYS = "family", "basis", "stabilisation", "seed"


def arguments(words=None):
    """The command line."""
    options = parser("Random problems, and how each of them ends.")
    add = options.add_argument
    add("--family", type=numbers(str), default=list(FAMILIES), help="by commas")
    add("--basis", type=numbers(str), default=list(BASES), help="by commas")
    add("--stabilisation", type=numbers(str), default=list(STABILISATIONS),
        help=f"by commas; also {', '.join(OTHERS)}")  # fmt: skip
    add("--start", type=int, default=0, help="first seed")
    add("--seeds", type=int, default=12, help="number of seeds")
    add("--seed", type=int, help="one seed alone")
    add("--first", type=int, help="number of problems, of all that these options name")
    add("--ranks", action="store_true", help="all ranks take each problem together")
    add("--compare", type=int, default=20, metavar="N",
        help="of several ranks: run every N-th problem by all together too; 0: none")  # fmt: skip
    add("--strict", action="store_true", help="fail if a stabilised problem ends wrong")
    add("--resume", action="store_true", help="keep the results that are there, and go on")
    given = options.parse_args(words)
    allowed = {"family": FAMILIES, "basis": BASES, "stabilisation": (*STABILISATIONS, *OTHERS)}
    for option, values in allowed.items():
        for word in getattr(given, option):
            if word not in values:
                options.error(f"{option} = {word} must be of {', '.join(values)}")
    if min(given.seeds, 1 if given.first is None else given.first) < 1 or given.compare < 0:
        options.error("seeds and first must be at least 1, compare at least 0")
    return given


# %% [markdown]
# ## Results in a file
# A line is written by one call, and a run that is killed leaves at most one line that is no JSON.


# %%
def key(result: dict[str, Any]) -> tuple[Any, ...]:
    """What names a result."""
    return tuple(result[name] for name in KEYS)


def read(path: Path) -> dict[tuple[Any, ...], dict[str, Any]]:
    """Results by their names; lines that are broken off do not count."""
    found = {}
    for line in path.read_text().splitlines() if path.exists() else []:
        try:
            result = json.loads(line)
        except json.JSONDecodeError:
            continue
        found[key(result)] = result
    return found


def append(path: Path, result: dict[str, Any]) -> None:
    """Append a line, in one piece; an empty line in front ends one that was broken off."""
    file = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
    try:
        os.write(file, ("\n" + json.dumps(result) + "\n").encode())
    finally:
        os.close(file)


def tell(result: dict[str, Any]) -> None:
    """A line on a problem."""
    name = Name(*key(result))
    print(
        f"{name.family:9s} {name.basis:8s} {name.stabilisation:12s} seed {name.seed:3d}  "
        f"{result['outcome']:10s} {result['seconds']:5.1f} s  {result['reason'][:90]}",
        flush=True,
    )


def run_all(wanted: list[Name], path: Path, args: Any) -> None:
    """Run what is not in the file yet. Collective."""
    comm = WORLD if args.ranks else MPI.COMM_SELF
    known = WORLD.bcast(read(path) if WORLD.rank == 0 else None)
    missing = [name for name in wanted if (*vars(name).values(),) not in known]
    for name in missing if args.ranks else missing[WORLD.rank :: WORLD.size]:
        result = run(name, comm)
        if comm.rank == 0:
            append(path, result)
            tell(result)
    WORLD.barrier()


def compare(wanted: list[Name], path: Path, args: Any) -> int:
    """Run a sample on all ranks together; what differs from one rank is wrong. Collective."""
    if WORLD.size == 1 or args.ranks or not args.compare:
        return 0
    known = WORLD.bcast(read(path) if WORLD.rank == 0 else None)
    # without stabilisation rounding decides how a run ends
    stabilised = [name for name in wanted if name.stabilisation != "none"]
    sample = [
        name for name in stabilised[:: args.compare]
        if "ranks" not in known[(*vars(name).values(),)]
    ]  # fmt: skip
    for name in sample:
        alone = known[(*vars(name).values(),)]
        together = run(name, WORLD)
        unequal = differs(alone, together) if alone["outcome"] == END else ""
        result = {**alone, "ranks": WORLD.size, "mean_moved_together": together.get("mean_moved")}
        if unequal:
            told = together["reason"][:200]
            result |= {"outcome": WRONG, "reason": f"on {WORLD.size} ranks: {unequal}. {told}"}
        if WORLD.rank == 0:
            append(path, result)
            tell(result)
    WORLD.barrier()
    return len(sample)


# %% [markdown]
# ## Table
# Halvings and iterations are per step, seconds per problem.


# %%
def table(results: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """A row for each family, basis and stabilisation."""
    rows: dict[tuple[str, ...], list[dict[str, Any]]] = {}
    for result in results:
        rows.setdefault(key(result)[:3], []).append(result)
    found = []
    for (family, basis, stabilisation), group in rows.items():
        steps = max(1, sum(r.get("steps_done", 0) for r in group))
        share = {kind: sum(r["outcome"] == kind for r in group) for kind in (END, TOLD, WRONG)}
        found.append({
            "family": family, "basis": basis, "stabilisation": stabilisation,
            "problems": len(group), "success": share[END] / len(group),
            "told": share[TOLD], "wrong": share[WRONG],
            "halvings": sum(r.get("halvings", 0) for r in group) / steps,
            "iterations": sum(r.get("iterations", 0) for r in group) / steps,
            "seconds": sum(r["seconds"] for r in group) / len(group),
        })  # fmt: skip
    order = [list(FAMILIES), BASES, (*STABILISATIONS, *OTHERS)]
    return sorted(found, key=lambda r: [o.index(r[k]) for o, k in zip(order, KEYS)])


def shares_by(name: str, results: list[dict[str, Any]]) -> dict[str, float]:
    """Share of the problems that came to the end, by the value of a key."""
    ends: dict[str, list[bool]] = {}
    for result in results:
        ends.setdefault(result[name], []).append(result["outcome"] == END)
    return {value: sum(group) / len(group) for value, group in ends.items()}


def summary(results: list[dict[str, Any]]) -> dict[str, Any]:
    """The table, shares by stabilisation and basis, the worst seeds with their commands."""
    shares = shares_by("stabilisation", results)
    ghost = [r for r in results if r["stabilisation"] == "ghost"]
    seconds = {}
    for family in dict.fromkeys(r["family"] for r in results):
        spent = [r["seconds"] for r in results if r["family"] == family]
        seconds[family] = sum(spent) / len(spent)
    failed = [r for r in results if r["outcome"] != END]
    failed.sort(key=lambda r: (r["outcome"] != WRONG, r["stabilisation"] == "none"))
    worst = [
        {"outcome": r["outcome"], "reason": r["reason"], "command": Name(*key(r)).command}
        for r in failed
    ]
    return {
        "problems": len(results), "success": shares,
        "success_with_ghost": shares_by("basis", ghost), "wrong": sum(
            r["outcome"] == WRONG for r in results
        ), "wrong_stabilised": sum(
            r["outcome"] == WRONG and r["stabilisation"] != "none" for r in results
        ), "seconds": seconds, "table": table(results), "worst": worst,
    }  # fmt: skip


def show(figures: dict[str, Any], most: int = 12) -> None:
    """Print the table and the worst seeds."""
    for row in figures["table"]:
        say(
            "{family:9s} {basis:8s} {stabilisation:12s} {problems:4d} problems, {success:6.1%} to "
            "the end, {told:3d} told why, {wrong:2d} wrong; per step {halvings:.2f} halvings, "
            "{iterations:4.1f} iterations; {seconds:.1f} s".format(**row)
        )
    for one in figures["worst"][:most]:
        say(f"{one['outcome']}: {one['reason'][:100]}\n    {one['command']}")
    spent = ", ".join(f"{family} {time:.1f}" for family, time in figures["seconds"].items())
    say(f"seconds per problem: {spent}")
    for what, name in (("with ghost", "success_with_ghost"), ("to the end", "success")):
        shares = ", ".join(f"{kind} {share:.1%}" for kind, share in figures[name].items())
        say(f"{figures['problems']} problems, {figures['wrong']} wrong; {what}: {shares}")


# %% [markdown]
# ## Runs


# %%
def main(words=None):
    """Run, print, and return the figures."""
    args = arguments(words)
    seeds = range(args.start, args.start + args.seeds) if args.seed is None else [args.seed]
    wanted = names(args.family, args.basis, args.stabilisation, seeds)[: args.first]
    path = args.output / "stability_atlas.jsonl"
    if WORLD.rank == 0:
        path.parent.mkdir(parents=True, exist_ok=True)
        if not args.resume:
            path.unlink(missing_ok=True)
    WORLD.barrier()
    run_all(wanted, path, args)
    compared = compare(wanted, path, args)
    known = WORLD.bcast(read(path) if WORLD.rank == 0 else None)
    results = [known[(*vars(name).values(),)] for name in wanted]
    figures = {**summary(results), "compared": compared}
    show(figures)
    if not args.no_plot:
        mpm.study.write_table(figures["table"], args.output / "stability_atlas.csv")
        if WORLD.rank == 0:
            atlas_pictures.draw(args.output / "stability_atlas.png", results)
    finish(args, figures)
    if args.strict and figures["wrong_stabilised"]:
        raise SystemExit(f"{figures['wrong_stabilised']} stabilised problems end wrong")
    return figures


if __name__ == "__main__":
    main()
