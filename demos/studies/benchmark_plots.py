"""Pictures of the benchmark: work against precision, what a step consists of, and growth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from benchmark_scenes import BASES, SCENES, Run

import dolfinmpm as mpm

NAMES = {"linear": "linear", "gimp": "GIMP", "bspline2": "quadratic splines",
         "bspline3": "cubic splines"}  # fmt: skip
COLOURS = dict(zip(BASES, ("C0", "C1", "C2", "C3")))
MARKERS = {"none": "o", "ghost": "s", "aggregation": "^", "explicit": "D"}
PEERS = {"kratos": ("*", "Kratos, linear")}
PARTS = ("C5", "C0", "C2", "C1", "C4", "C3", "0.6")


def work_precision(path: Any, runs: Sequence[Run], peers: Sequence[dict[str, Any]]) -> None:
    """Seconds against errors, a panel a scene; lines join refinements.

    Of points per cell the fewest are drawn solid, more of them open.
    """
    from matplotlib.lines import Line2D
    from matplotlib.ticker import LogLocator, NullFormatter

    names = list(dict.fromkeys(run.scene for run in runs))
    columns = min(3, len(names) + 1)
    # one place more, for the legend
    rows = -(-(len(names) + 1) // columns)
    with mpm.figure(
        path, 2.45 * columns, 2.25 * rows, nrows=rows, ncols=columns, squeeze=False
    ) as (_, axes):
        axes = axes.ravel()
        for name, ax in zip(names, axes):
            own = [run for run in runs if run.scene == name and run.error]
            least = min((run.per_cell for run in own if run.basis != "bspline3"), default=2)
            series: dict[tuple, list[Run]] = {}
            for run in own:
                series.setdefault((run.basis, run.stabilisation, run.per_cell), []).append(run)
            for (basis, stabilisation, per_cell), members in series.items():
                members.sort(key=lambda run: run.points)
                solid = per_cell <= max(least, 3 if basis == "bspline3" else 0)
                colour = COLOURS[basis]
                ax.loglog(
                    [run.seconds for run in members], [run.error for run in members],
                    marker=MARKERS[stabilisation], color=colour, mfc=colour if solid else "white",
                    lw=0.8 if solid else 0.5, ls="-" if solid else ":", ms=3.5, mew=0.7,
                )  # fmt: skip
            for code, (marker, _) in PEERS.items():
                found = [p for p in peers if p["code"] == code and p["scene"] == name]
                if found:
                    ax.loglog(
                        [p["seconds"] for p in found], [p["error"] for p in found], marker=marker,
                        color="black", ms=6, lw=0.8,
                    )  # fmt: skip
            ax.set_title(name)
            ax.set(xlabel="processor time (s)", ylabel=f"error: {SCENES[name].error}")
            for axis in (ax.xaxis, ax.yaxis):
                low, high = axis.get_view_interval()
                # at least a decade: fewer have no whole powers to read
                more = max(1.0, (10.0 * low / high) ** 0.5)
                axis.set_view_interval(low / more, high * more, ignore=True)
                if high / low < 20:
                    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
                    axis.set_major_formatter("{x:g}")
                axis.set_minor_formatter(NullFormatter())
        bases = [basis for basis in BASES if any(run.basis == basis for run in runs)]
        stabilisations = [r for r in MARKERS if any(run.stabilisation == r for run in runs)]
        handles = [Line2D([], [], color=COLOURS[b], lw=2, label=NAMES[b]) for b in bases]
        words = {
            "none": "no stabilisation",
            "ghost": "ghost penalty",
            "explicit": "explicit, lumped",
        }
        handles += [
            Line2D([], [], ls="", marker=MARKERS[r], color="0.3", label=words.get(r, r))
            for r in stabilisations
        ]
        if any(
            len(SCENES[name].per_cell) > 1
            and len({run.per_cell for run in runs if run.scene == name and run.basis != "bspline3"})
            > 1
            for name in names
        ):
            handles.append(
                Line2D([], [], ls=":", marker="o", mfc="white", color="0.3",
                       label="more points per cell")
            )  # fmt: skip
        handles += [
            Line2D([], [], color="black", marker=PEERS[code][0], ms=6, label=PEERS[code][1])
            for code in dict.fromkeys(p["code"] for p in peers)
        ]
        axes[len(names)].legend(handles=handles, loc="center", fontsize=8)
        for ax in axes[len(names) :]:
            ax.set_axis_off()


def stages(path: Any, runs: Sequence[Run]) -> None:
    """Shares of the stages of the finest run of each scene and basis, as bars."""
    finest: dict[str, Run] = {}
    for run in runs:
        if run.error is None or not run.stages:
            continue
        name = f"{run.scene}, {NAMES[run.basis]}"
        if name not in finest or run.points >= finest[name].points:
            finest[name] = run
    names = list(finest)[::-1]
    with mpm.figure(path, 6.5, 0.9 + 0.2 * len(names)) as (_, ax):
        left = np.zeros(len(names))
        parts = [part for part in next(iter(finest.values())).stages if part != "output"]
        for part, colour in zip(parts, PARTS):
            share = [finest[n].stages[part] / sum(finest[n].stages.values()) for n in names]
            ax.barh(names, share, left=left, color=colour, label=part, height=0.75)
            left += share
        ax.set(xlim=(0, 1), xlabel="share of the time of a step")
        ax.grid(visible=False)
        ax.legend(ncols=len(parts), loc="lower center", bbox_to_anchor=(0.5, 1.0))


def growth(path: Any, found: dict[str, Any]) -> None:
    """Processor seconds per step against points, cells and ranks."""
    from matplotlib.ticker import NullLocator

    looks = {"explicit": "o", "implicit": "s", "gimp": "v", "solid": "^", "aggregated": "D"}
    kinds = list(dict.fromkeys(name.partition(",")[0] for name in found))
    with mpm.figure(path, 2.6 * len(kinds), 2.5, ncols=len(kinds), squeeze=False) as (_, axes):
        for kind, ax in zip(kinds, axes[0]):
            own = {k: v for k, v in found.items() if k.partition(",")[0] == kind}
            for name, series in own.items():
                rows = [row for row in series["rows"] if "failed" not in row]
                if not rows:
                    continue
                label = name.partition(", ")[2]
                if series["exponent"] is not None:
                    label += f": {series['exponent']:.2f}"
                style = "--" if "weak" in name else "-"
                ax.loglog(
                    [row[kind] for row in rows], [row["seconds_processor"] for row in rows],
                    style, marker=next(m for k, m in looks.items() if k in name),
                    color=f"C{[k in name for k in looks].index(True)}", label=label,
                )  # fmt: skip
            ax.set(xlabel=f"{kind}", ylabel="processor time of a step (s)")
            low, high = ax.get_ylim()
            # room for the legend
            ax.set_ylim(low, high * (high / low) ** 0.5)
            ax.legend(title="fitted exponents", title_fontsize=7, loc="upper left")
            if kind == "ranks":
                known = sorted({row["ranks"] for s in own.values() for row in s["rows"]})
                ax.set_xticks(known, [str(k) for k in known])
                ax.xaxis.set_minor_locator(NullLocator())
