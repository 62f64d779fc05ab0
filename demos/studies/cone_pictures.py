"""Pictures of `cone_penetration.py`: a run, and the resistance of runs with water by velocity."""

from __future__ import annotations

import numpy as np
from cam_clay import PRESSURE
from cone_in_water import backbone
from scene import draw_points

import dolfinmpm as mpm


def draw(args, scene, figures):
    """Force against depth, and the ground beside the cone; rank 0 writes."""
    points, R = scene.points, args.radius
    shown = "pressure" if scene.wet else "plastic_strain"
    found = points.gather("x", "F", "l0", shown)
    if found is None:
        return
    x, F, l0, values = found
    label = r"$\log_{10}$ plastic strain"
    if scene.wet:
        values, label = (values + PRESSURE) / scene.unit, r"$\Delta u/c_u$"
    else:
        values = np.log10(values + 1e-3)
    if not scene.flat:
        # points beside the plane of symmetry
        near = x[:, 1] < 0.5 * args.h
        x, l0, values = x[near][:, [0, 2]], l0[near][:, [0, 2]], values[near]
        F = F[near][:, [0, 2]][:, :, [0, 2]]
    path = args.output / f"cone_penetration_{args.law}_{args.dimension}.png"
    with mpm.figure(path, 7.0, 3.6, ncols=2, width_ratios=(1, 1.2)) as (fig, (left, right)):
        depth = scene.history["depth"]
        left.plot(scene.history["factor"], depth, lw=1, color="C1")
        if "factor_exact" in figures:
            left.axvline(figures["factor_exact"], color="C0", lw=1, label="Teh & Houlsby")
            left.legend()
        name = "$q_c$ (kPa)" if args.law == "sand" else "$q_c/c_u$"
        left.set(xlabel=name, ylabel="depth of the tip (m)", xlim=(0, None))
        left.set_ylim(depth[-1], args.start)
        drawn = draw_points(right, x, F[:, :2, :2], l0, values, cmap="magma")
        tip = -scene.depth
        meridian = np.array([(0, tip), (R, tip + scene.height), (R, tip + 9 * R), (0, tip + 9 * R)])
        right.fill(*meridian.T, color="0.6", zorder=3)
        right.set(xlim=(0, 4 * R), ylim=(tip - 2 * R, tip + 5 * R))
        right.set(xlabel="radius (m)", ylabel="height (m)")
        fig.colorbar(drawn, label=label)


def draw_curve(path, runs, figures):
    """Resistance and pore pressure against the velocity."""
    V = np.array([run["velocity"] for run in runs])
    q = np.array([run["factor"] for run in runs])
    line = np.geomspace(V[0], V[-1], 200)
    with mpm.figure(path, 6.8, 2.6, ncols=2) as (_, (left, right)):
        left.semilogx(line, backbone(line, figures["drained_ratio"]), color="0.6", label="backbone")
        scatter = [run["scatter"] for run in runs] / q[-1]
        if "V50_fitted" in figures:
            fitted = figures["drained_ratio"], figures["V50_fitted"], figures["m_fitted"]
            left.semilogx(line, backbone(line, *fitted), "C0--", lw=0.8)
        left.errorbar(V, q / q[-1], scatter, fmt="o", ms=3, lw=0.8, label="material points")
        left.set(xlabel="$v d/c_v$", ylabel="$q/q_{undrained}$", ylim=(0, None))
        left.legend()
        right.semilogx(V, [run["pore_ratio"] for run in runs], "o-", ms=3, lw=0.8)
        right.set(xlabel="$v d/c_v$", ylabel="$\\Delta u_2/q$")
