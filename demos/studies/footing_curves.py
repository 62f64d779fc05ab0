"""What `footing.py` makes of its curves: a comparison with stored ones, words, pictures.

The stored curves are of conforming elements. With cells of 0.25 m they are known to 0.1 %
(centre) and 0.5 % (mean) for Cam-Clay. For Tresca's clay they are up to 56 kPa; beyond, the
ground beside the edge stretches the further the smaller the elements.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from options import Options
from scene import draw_points

import dolfinmpm as mpm

STORED = Path(__file__).resolve().parents[2] / "tests" / "reference"
# what the ground is coloured by: what its law remembers
LABELS = {
    "preconsolidation_pressure": "preconsolidation pressure $p_c$ (kPa)",
    "plastic_strain": r"plastic strain $\bar\varepsilon^p$ (%)",
}
SCALES = {"preconsolidation_pressure": 1e-3, "plastic_strain": 100.0}


def stored(args: Options) -> np.ndarray | None:
    """Load (Pa) and settlement (m) of centre, mean and edge by conforming elements, or None.

    Returns:
        Shape (4, loads).
    """
    rough = args.rough == "on"
    if (
        args.footing == "rigid"
        or args.law == "tresca-perfect"
        or (args.law == "cam-clay" and rough)
    ):
        return None
    scene = "cam_clay" if args.law == "cam-clay" else "tresca" if rough else "tresca_smooth"
    strain = "small" if args.strain == "small" else "large"
    with open(STORED / f"{scene}_footing.csv", newline="") as file:
        table = csv.DictReader(line for line in file if not line.startswith("#"))
        names = "load_Pa", "centre_m", "mean_m", "edge_m"
        rows = [
            [float(row[k]) for k in names]
            for row in table
            if row["strain"] == strain and float(row["h_m"]) == 0.25
        ]
    return np.array(rows).T


def compared(curve: np.ndarray, reference: np.ndarray) -> dict[str, float]:
    """Figures of a curve against another, at the last load of both and at most on the way.

    Args:
        curve, reference: Load (Pa) and settlement (m) as `stored` gives them.
    """
    at = min(curve[0, -1], reference[0, -1])
    found, expected = ([np.interp(at, c[0], c[k]) for k in (1, 2)] for c in (curve, reference))
    figures = {"compared_at": float(at)}
    common = curve[:, curve[0] < at * (1 + 1e-12)]
    for k, name in ((1, "centre"), (2, "mean")):
        gap = common[k] - np.interp(common[0], reference[0], reference[k])
        figures[f"reference_{name}"] = float(expected[k - 1])
        figures[f"deviation_{name}"] = float(found[k - 1] / expected[k - 1] - 1)
        figures[f"max_deviation_{name}"] = float(np.abs(gap).max() / expected[k - 1])
    return figures


def describe(args: Options, f: dict[str, Any]) -> str:
    """Some lines on a run."""
    text = (
        f"{args.law}, {args.strain} strain, {args.basis}, F-bar {args.fbar}, {args.footing}, rough "
        f"{args.rough}, h = {args.h:g} m, {args.points_per_cell}² points, {args.stabilisation}: at "
        f"{f['load'] / 1e3:.2f} kPa {f['settlement_centre']:.4f} m in the centre, "
        f"{f['settlement_mean']:.4f} m on average; {f['newton_iterations']} iterations, "
        f"{f['halvings']} halvings, {f['seconds_solve']:.1f} s"
    )
    if "compared_at" in f:
        text += (
            f"\n    conforming elements at {f['compared_at'] / 1e3:g} kPa: "
            f"{f['reference_centre']:.4f} and {f['reference_mean']:.4f} m; deviation "
            f"{f['deviation_centre']:+.2%} and {f['deviation_mean']:+.2%}"
        )
    if "bearing_factor" in f:
        text += (
            f"\n    bearing factor {f['bearing_factor']:.4f}, Prandtl's {2 + np.pi:.4f} "
            f"({f['bearing_error']:+.2%}); the last fifth added {f['last_rise']:.2%}"
        )
    return text + (f"\n    ended early: {f['reason'][:400]}" if f["reason"] else "")


def _draw_curve(axes: Any, args: Options, figures: dict[str, Any], label: str, **look: Any) -> None:
    """Draw the settlement in the centre, which is all of a rigid footing's, over pressure."""
    curve = np.array(figures["curve"])
    unit = 1e3 if args.settlement < 0.1 and args.footing == "rigid" else 1.0
    axes.plot(curve[0] / 1e3, unit * curve[1], label=label, **look)
    what = "settlement" if args.footing == "rigid" else "settlement in the centre"
    axes.set(xlabel="pressure on the footing (kPa)", xlim=(0, None))
    axes.set_ylabel(f"{what} ({'mm' if unit > 1 else 'm'})")


def _finish_curves(axes: Any, args: Options, strains: Sequence[str], limit: float) -> None:
    """Add what the curves are compared with; settlement points down."""
    for strain, dashes in zip(strains, ("-", (0, (4, 2)))):
        reference = stored(replace(args, strain=strain))
        if reference is not None:
            name = "conforming elements" + (f", {strain}" if len(strains) > 1 else "")
            axes.plot(
                reference[0] / 1e3, reference[1], "k", ls=dashes, lw=0.8, label=name, zorder=1
            )
    if args.law == "tresca-perfect":
        axes.axvline(limit / 1e3, color="k", lw=0.8, label=r"$(2 + \pi)\,c$")
    axes.set_ylim(0, None)
    axes.invert_yaxis()
    axes.legend(loc="lower left")


def draw_run(
    path: Path,
    args: Options,
    figures: dict[str, Any],
    state: Sequence[np.ndarray],
    name: str,
    size: tuple[float, float, float],
    limit: float,
) -> None:
    """Pressure over settlement beside the ground as it is at the end.

    Args:
        path: Picture to write.
        args: The command line.
        figures: Figures of the run.
        state: x, F, l0 and the variable that colours the ground, of all points.
        name: Name of this variable.
        size: Width and depth of the ground, room above it (m).
        limit: Prandtl's limit (Pa).
    """
    width, depth, room = size
    rigid = args.footing == "rigid"
    ratio = 1.4 if rigid else 1.7
    with mpm.figure(path, 7.5, 2.5, ncols=2, width_ratios=(1, ratio)) as (figure, (left, right)):
        every = max(1, args.steps // 25)
        look = {"color": "C1", "marker": "o", "ms": 3, "lw": 0, "markevery": every}
        _draw_curve(left, args, figures, "material points", **look)
        _finish_curves(left, args, ["small" if args.strain == "small" else "large"], limit)
        x, F, l0, values = state
        values = SCALES[name] * values
        colours = values.min(), np.percentile(values, 98 if rigid else 99.5)
        drawn = draw_points(right, x, F, l0, values, cmap="viridis", clim=colours)
        right.plot([0, width], [depth, depth], color="0.4", lw=0.6, ls="--")
        right.set(xlim=(0, 8 if rigid else width), ylim=(0, depth + (0.2 if rigid else room)))
        bar = figure.colorbar(drawn, ax=right, extend="max", shrink=0.8, aspect=15)
        bar.set_label(LABELS[name])


def draw_compared(
    path: Path, args: Options, results: Sequence[dict[str, Any]], limit: float
) -> None:
    """The curves of `--compare` in one picture.

    Args:
        path: Picture to write.
        args: The command line.
        results: Label and figures of each run. But for Cam-Clay they come in pairs, without
            and with F-bar.
        limit: Prandtl's limit (Pa).
    """
    pairs = args.law != "cam-clay"
    with mpm.figure(path, 3.5, 3.2) as (_, axes):
        for k, r in enumerate(results):
            look: dict[str, Any] = {"color": f"C{k // 2}", "ls": ":" if k % 2 == 0 else "-"}
            if not pairs:
                look = {"color": f"C{k + 1}", "marker": "o", "ms": 3, "lw": 0}
                look["markevery"] = max(1, args.steps // 20)
            _draw_curve(axes, args, r, r["label"], **look)
        _finish_curves(axes, args, ["large"] if pairs else ["large", "small"], limit)
        if args.law == "tresca":
            # they part only when much of the ground flows
            axes.set(xlim=(0.6 * args.load / 1e3, 1.01 * args.load / 1e3), ylim=(1.05, 0.1))
