"""Measured surfaces of the collapse of `column_collapse.py`, and its pictures."""

from __future__ import annotations

import numpy as np
from scene import draw_points

import dolfinmpm as mpm

# the surface at rest, and the line of failure (Bui and others 2008), x and y in m
PLACES = np.array([0.04, 0.08, 0.12, 0.16, 0.20, 0.241, 0.282, 0.322, 0.362, 0.402, 0.442])
MEASURED = np.array(
    [0.0959, 0.0844, 0.0722, 0.0616, 0.0474, 0.0348, 0.0265, 0.0189, 0.0109, 0.0037, 0.0015]
)
CREST = 0.0992
MEASURED_TOE = 0.434
LINE = np.array(
    [(0.021, 0.0989), (0.080, 0.0652), (0.120, 0.0368), (0.160, 0.0104), (0.179, 0.0005)]
)


def draw_measured(axes):
    """The measured surface."""
    look = {"color": "black", "ls": "none", "zorder": 4}
    axes.plot([0, *PLACES], [CREST, *MEASURED], "o", ms=3, mfc="white", **look)
    axes.lines[-1].set_label("measured")


def picture(path, args, figures, states, profile):
    """Draw snapshots, and the surface at rest against the measured one."""
    reach, top = 1.03 * max(0.48, figures["toe"][-1]), 1.12 * args.height
    rows = len(states) + 1
    height = 0.6 + rows * (0.25 + 5.2 * top / reach)
    with mpm.figure(path, 6.5, height, nrows=rows, sharex=True) as (whole, axes):
        for ax, (t, (x, F, l0, strain)) in zip(axes, states):
            # undeformed, and a little larger than they are: F of what flows tells nothing of shape
            whole_squares = np.broadcast_to(np.eye(2), F.shape)
            drawn = draw_points(ax, x, whole_squares, 1.4 * l0, strain, cmap="viridis", clim=(0, 5))
            ax.text(0.98, 0.8, f"$t$ = {t:g} s", transform=ax.transAxes, ha="right")
            ax.set(xlim=(0, reach), ylim=(0, top), xlabel="")
        axes[-2].plot(*LINE.T, "x", ms=3.5, color="#D55E00", label="line of failure, measured")
        axes[-2].legend(loc="center right")
        bar = whole.colorbar(drawn, ax=[*axes[:-1]], extend="max", shrink=0.6, aspect=30)
        bar.set_label("plastic strain")
        last = axes[-1]
        x, y = np.append(0.0, profile[0]), np.append(profile[1][0], profile[1])
        last.fill_between(x, y, color="#0072B2", alpha=0.2, lw=0)
        last.plot(x, y, label="computed, at rest")
        last.plot(
            [0, args.width, args.width], [args.height, args.height, 0], color="0.5", ls="--",
            lw=0.6, label="before",
        )  # fmt: skip
        draw_measured(last)
        last.set(aspect="equal", xlim=(0, reach), ylim=(0, top), xlabel="$x$ (m)", ylabel="$y$ (m)")
        last.legend()


def variants_picture(path, args, results):
    """Draw the surfaces of all variants against the measured one."""
    rows, columns = len(args.integrators), len(args.bases)
    colours = {"on": "C0", "off": "C1"}
    lines = {"large": "-", "small": "--", "jaumann": ":"}
    with mpm.figure(
        path, 7.2, 0.7 + 1.5 * rows, nrows=rows, ncols=columns, sharex=True, sharey=True,
        squeeze=False,
    ) as (whole, axes):  # fmt: skip
        for row, integrator in zip(axes, args.integrators):
            for ax, basis in zip(row, args.bases):
                draw_measured(ax)
                for one, profile in results:
                    if (one["integrator"], one["basis"]) != (integrator, basis):
                        continue
                    label = f"{one['strain']}, F-bar {one['fbar']}"
                    label += "" if one["completed"] else " (not to the end)"
                    ax.plot(*profile, lines[one["strain"]], color=colours[one["fbar"]], lw=0.9,
                            label=label)  # fmt: skip
                ax.set_title(f"{integrator}, {basis}")
                ax.set(xlim=(0, 0.56), ylim=(0, 0.11))
        for ax in axes[-1]:
            ax.set_xlabel("$x$ (m)")
        for ax in axes[:, 0]:
            ax.set_ylabel("$y$ (m)")
        handles, labels = axes[0, 0].get_legend_handles_labels()
        whole.legend(handles, labels, loc="outside lower center", ncols=4)
