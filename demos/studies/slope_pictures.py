"""Sizes and pictures of the wet slope of `coupled_slope.py`."""

from __future__ import annotations

import numpy as np
from cam_clay import PRESSURE
from scene import draw_points

import dolfinmpm as mpm

HEIGHT, BASE, TOE, WIDTH, ROOM = 6.0, 2.0, 14.0, 26.0, 1.0
# which limit a way of loading comes to
LIMITS = {"fast": "undrained", "slow": "drained"}


def sheared(F):
    """Logarithmic shear strain ½ ln(λ₁/λ₂) of deformation gradients, shape (n, 2, 2)."""
    stretch = np.linalg.svd(F[:, :2, :2], compute_uv=False)
    return 0.5 * np.log(stretch[:, 0] / stretch[:, 1])


def picture(path, args, runs, states, strength):
    """Draw the curves of all runs, and the states of the runs with water.

    Displacements against the load, or against the time while the load is held. Below, where the
    body lies in the end, or when it fails while the load is held, with the pressure beyond the
    first pressure and with the shear strain.

    Args:
        path: Picture to write.
        args: The command line.
        runs: Figures of each run, by the way of loading.
        states: x, F, l0 and pressure (Pa) of all points, by the way of loading.
        strength: Undrained strength (Pa), the unit of pressures.
    """
    rows = len(states)
    with mpm.figure(path, 7.2, 2.4 + 1.6 * rows) as (whole, old):
        old.remove()
        upper, lower = whole.subfigures(2, 1, height_ratios=(2.4, 1.6 * rows))
        left, right = upper.subplots(1, 2)
        colours = {"fast": "C3", "undrained": "C3", "slow": "C0", "drained": "C0", "timed": "C2"}
        for way, result in runs.items():
            look = {"color": colours[way], "lw": 1.2}
            if way in LIMITS.values():
                look |= {"lw": 3.5, "alpha": 0.3}
            left.plot(result["moved"], result["N"], label=way, **look)
            if args.hold and "excess" in result:
                right.semilogx(result["T"], result["moved"], label=way, **look)
            elif "excess" in result:
                right.plot(result["N"], result["excess"], label=way, **look)
            if way not in LIMITS.values() and result["taylor"] is not None:
                left.axhline(result["taylor"], color=colours[way], lw=0.6, ls="--")
        left.set(xlabel="largest displacement / $H$", ylabel="$N = \\gamma' H/c_u$")
        left.set(xlim=(0, 0.2), ylim=(0, None))
        left.legend(loc="lower right")
        if args.hold:
            right.set(xlabel="$c_v t/H^2$", ylabel="largest displacement / $H$")
        else:
            right.set(xlabel="$N$", ylabel="excess pressure on the slip / $c_u$")
        excess = {way: (state[3] + PRESSURE) / strength for way, state in states.items()}
        limits = [f([f(values) for values in excess.values()]) for f in (np.min, np.max)]
        panels = np.atleast_2d(lower.subplots(rows, 2, sharex=True, sharey=True))
        for (axes, other), (way, (x, F, l0, _)) in zip(panels, states.items()):
            drawn = draw_points(axes, x, F, l0, excess[way], cmap="cividis", clim=limits)
            lower.colorbar(drawn, ax=axes, label="excess pressure / $c_u$", shrink=0.9)
            drawn = draw_points(other, x, F, l0, sheared(F), cmap="viridis", clim=(0, 0.5))
            lower.colorbar(drawn, ax=other, label="shear strain", extend="max", shrink=0.9)
            for ax in (axes, other):
                ax.set(xlim=(4, 22), ylim=(0, BASE + HEIGHT + ROOM), title=way)
