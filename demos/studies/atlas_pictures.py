"""The map of outcomes: a panel per family and stabilisation, a row per basis, a cell per seed."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

import dolfinmpm as mpm

__all__ = ["draw"]

COLOURS = {"to the end": "#A6D3C2", "told why": "#E8A87C", "wrong": "#7A1F5C"}
NOTHING = "#F0F0F0"


def draw(path: Path, results: list[dict[str, Any]]) -> None:
    """Draw the outcomes of all problems. On one rank."""
    families, kinds, bases = (
        list(dict.fromkeys(r[key] for r in sorted(results, key=lambda r: ORDER.index(r[key]))))
        for key in ("family", "stabilisation", "basis")
    )
    seeds = sorted({r["seed"] for r in results})
    height = 0.75 + len(families) * (0.35 + 0.16 * len(bases))
    with mpm.figure(
        path, 7.2, height, nrows=len(families), ncols=len(kinds), squeeze=False, sharex=True,
        sharey=True,
    ) as (figure, axes):  # fmt: skip
        for row, family in zip(axes, families):
            for panel, kind in zip(row, kinds):
                group = [r for r in results if (r["family"], r["stabilisation"]) == (family, kind)]
                _panel(panel, group, bases, seeds)
                good = sum(r["outcome"] == "to the end" for r in group)
                told = f"{good} of {len(group)} to the end" if group else "not run"
                panel.set_title(f"{kind}: {told}", fontsize=7, pad=4)
            row[0].set_ylabel(TITLES[family])
        for panel in axes[-1]:
            panel.set_xlabel("seed")
        _legend(figure)


TITLES = {
    "slopes": "slopes", "bodies": "rigid bodies\nin soil", "impacts": "collisions,\nimplicit",
    "explicit": "collisions,\nexplicit", "water": "soil with\nwater",
}  # fmt: skip
ORDER = [
    "slopes", "bodies", "impacts", "explicit", "water", "none", "ghost", "aggregation",
    "weak-aggregation", "extended", "soft", "linear", "gimp", "bspline2", "bspline3",
]  # fmt: skip


def _panel(axes: Any, group: list[dict[str, Any]], bases: list[str], seeds: list[int]) -> None:
    from matplotlib.colors import ListedColormap

    kinds = list(COLOURS)
    values = np.full((len(bases), len(seeds)), -1)
    for r in group:
        values[bases.index(r["basis"]), seeds.index(r["seed"])] = kinds.index(r["outcome"])
    colours = ListedColormap([NOTHING, *COLOURS.values()])
    edges = np.arange(len(seeds) + 1), np.arange(len(bases) + 1)
    # thin white lines between cells, as long as cells are wider than they are
    line = {"edgecolors": "white", "linewidth": 0.4} if len(seeds) <= 60 else {}
    axes.pcolormesh(*edges, values, cmap=colours, vmin=-1.5, vmax=2.5, **line)
    axes.set_yticks(np.arange(len(bases)) + 0.5, labels=bases)
    shown = np.arange(0, len(seeds), max(1, math.ceil(len(seeds) / 6)))
    axes.set_xticks(shown + 0.5, labels=[seeds[k] for k in shown])
    axes.set(xlim=(0, len(seeds)), ylim=(len(bases), 0))
    axes.tick_params(length=0)
    axes.grid(visible=False)


def _legend(figure: Any) -> None:
    from matplotlib.patches import Patch

    kinds = {**COLOURS, "not run": NOTHING}
    patches = [Patch(facecolor=colour, label=name) for name, colour in kinds.items()]
    figure.legend(handles=patches, loc="outside upper center", ncols=len(patches))
