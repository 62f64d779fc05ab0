"""The scene of `explicit_speed.py` in warp and in taichi, as their own examples of the MPM do it.

Each is FLIP with quadratic B-splines and a neo-Hookean law under large strain, in double
precision: points to nodes with atomic sums, the nodes, and back, one kernel each. Taichi runs
with one thread; warp's processor kernels have no more. Runs begin with half a step, as ours do.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["PEERS"]

Array = npt.NDArray[np.float64]
GRAVITY = -10.0


def warp_steps(scene: dict[str, Any]) -> tuple[Callable[[int], None], Callable[[], Array]]:
    """Steps by NVIDIA warp (warp-lang), and positions of the points (m), shape (n, 2)."""
    import warp as wp

    wp.config.log_level = 30
    wp.init()
    wp.set_device("cpu")
    n, side, held = len(scene["x"]), scene["side"], scene["held"]
    dt, mu, lmbda = (wp.float64(scene[k]) for k in ("dt", "mu", "lmbda"))
    mass, V0 = wp.float64(scene["mass"]), wp.float64(scene["V0"])
    gravity, half = wp.float64(GRAVITY), wp.float64(0.5)
    middle, nothing = wp.float64(0.75), wp.float64(0.0)
    per_h = wp.float64(1.0 / scene["h"])

    @wp.func
    def weights(f: wp.float64):
        return wp.vec3d(
            half * (half - f) * (half - f), middle - f * f, half * (half + f) * (half + f)
        )

    @wp.func
    def slopes(f: wp.float64):
        return wp.vec3d((f - half) * per_h, -(f + f) * per_h, (f + half) * per_h)

    @wp.kernel
    def to_grid(
        x: wp.array(dtype=wp.vec2d), v: wp.array(dtype=wp.vec2d), tau: wp.array(dtype=wp.mat22d),
        m: wp.array2d(dtype=wp.float64), p: wp.array2d(dtype=wp.vec2d),
        f: wp.array2d(dtype=wp.vec2d),
    ):  # fmt: skip
        k = wp.tid()
        at = x[k] * per_h
        i, j = int(at[0] + half), int(at[1] + half)
        fx, fy = at[0] - wp.float64(i), at[1] - wp.float64(j)
        wx, wy, dx, dy = weights(fx), weights(fy), slopes(fx), slopes(fy)
        momentum, force = mass * v[k], -V0 * tau[k]
        for a in range(3):
            for b in range(3):
                N = wx[a] * wy[b]
                wp.atomic_add(m, i + a - 1, j + b - 1, N * mass)
                wp.atomic_add(p, i + a - 1, j + b - 1, N * momentum)
                wp.atomic_add(
                    f, i + a - 1, j + b - 1, force * wp.vec2d(dx[a] * wy[b], wx[a] * dy[b])
                )

    @wp.kernel
    def on_grid(
        m: wp.array2d(dtype=wp.float64), p: wp.array2d(dtype=wp.vec2d),
        f: wp.array2d(dtype=wp.vec2d), v: wp.array2d(dtype=wp.vec2d), a: wp.array2d(dtype=wp.vec2d),
        kick: wp.float64,
    ):  # fmt: skip
        i, j = wp.tid()
        if m[i, j] > nothing:
            acceleration = f[i, j] / m[i, j] + wp.vec2d(nothing, gravity)
            v[i, j] = p[i, j] / m[i, j] + kick * acceleration
            if j < held:
                v[i, j] = wp.vec2d(nothing, nothing)
                acceleration = -p[i, j] / (m[i, j] * kick)
            a[i, j] = acceleration

    @wp.kernel
    def to_points(
        x: wp.array(dtype=wp.vec2d), v: wp.array(dtype=wp.vec2d), F: wp.array(dtype=wp.mat22d),
        tau: wp.array(dtype=wp.mat22d), v_node: wp.array2d(dtype=wp.vec2d),
        a_node: wp.array2d(dtype=wp.vec2d), kick: wp.float64,
    ):  # fmt: skip
        k = wp.tid()
        at = x[k] * per_h
        i, j = int(at[0] + half), int(at[1] + half)
        fx, fy = at[0] - wp.float64(i), at[1] - wp.float64(j)
        wx, wy, dx, dy = weights(fx), weights(fy), slopes(fx), slopes(fy)
        flow, change = wp.vec2d(), wp.vec2d()
        L = wp.mat22d()
        for a in range(3):
            for b in range(3):
                N = wx[a] * wy[b]
                here = v_node[i + a - 1, j + b - 1]
                flow += N * here
                change += N * a_node[i + a - 1, j + b - 1]
                L += wp.outer(here, wp.vec2d(dx[a] * wy[b], wx[a] * dy[b]))
        x[k] = x[k] + dt * flow
        v[k] = v[k] + kick * change
        new = (wp.identity(n=2, dtype=wp.float64) + dt * L) * F[k]
        F[k] = new
        J = wp.determinant(new)
        tau[k] = mu * (new * wp.transpose(new)) + (lmbda * wp.log(J) - mu) * wp.identity(
            n=2, dtype=wp.float64
        )

    x, v = wp.array(scene["x"], dtype=wp.vec2d), wp.array(scene["v"], dtype=wp.vec2d)
    F = wp.array(np.tile(np.eye(2), (n, 1, 1)), dtype=wp.mat22d)
    tau = wp.zeros(n, dtype=wp.mat22d)
    m = wp.zeros((side, side), dtype=wp.float64)
    p, f, v_node, a_node = (wp.zeros((side, side), dtype=wp.vec2d) for _ in range(4))
    kicks = itertools.chain([half * dt], itertools.repeat(dt))

    def go(steps: int) -> None:
        for kick in itertools.islice(kicks, steps):
            for sums in (m, p, f):
                sums.zero_()
            wp.launch(to_grid, dim=n, inputs=[x, v, tau, m, p, f])
            wp.launch(on_grid, dim=(side, side), inputs=[m, p, f, v_node, a_node, kick])
            wp.launch(to_points, dim=n, inputs=[x, v, F, tau, v_node, a_node, kick])

    return go, x.numpy


def taichi_steps(scene: dict[str, Any]) -> tuple[Callable[[int], None], Callable[[], Array]]:
    """Steps by taichi, and positions of the points (m), shape (n, 2)."""
    import taichi as ti

    ti.init(arch=ti.cpu, default_fp=ti.f64, cpu_max_num_threads=1, log_level=ti.WARN)
    n, side, held = len(scene["x"]), scene["side"], scene["held"]
    h, dt, mu, lmbda, mass, V0 = (scene[k] for k in ("h", "dt", "mu", "lmbda", "mass", "V0"))
    per_h = 1.0 / h
    x, v = ti.Vector.field(2, float, n), ti.Vector.field(2, float, n)
    F, tau = ti.Matrix.field(2, 2, float, n), ti.Matrix.field(2, 2, float, n)
    m, kick = ti.field(float, (side, side)), ti.field(float, ())
    p, f, v_node, a_node = (ti.Vector.field(2, float, (side, side)) for _ in range(4))

    @ti.kernel
    def to_grid():
        for k in x:
            at = x[k] * per_h
            base = int(at + 0.5)
            g = at - base
            w = [0.5 * (0.5 - g) ** 2, 0.75 - g**2, 0.5 * (0.5 + g) ** 2]
            s = [(g - 0.5) * per_h, -2.0 * g * per_h, (g + 0.5) * per_h]
            for a, b in ti.static(ti.ndrange(3, 3)):
                node = base + ti.Vector([a - 1, b - 1])
                N = w[a][0] * w[b][1]
                m[node] += N * mass
                p[node] += N * mass * v[k]
                f[node] -= V0 * tau[k] @ ti.Vector([s[a][0] * w[b][1], w[a][0] * s[b][1]])

    @ti.kernel
    def on_grid():
        for i, j in m:
            if m[i, j] > 0:
                acceleration = f[i, j] / m[i, j] + ti.Vector([0.0, GRAVITY])
                v_node[i, j] = p[i, j] / m[i, j] + kick[None] * acceleration
                if j < held:
                    v_node[i, j] = [0.0, 0.0]
                    acceleration = -p[i, j] / (m[i, j] * kick[None])
                a_node[i, j] = acceleration
            m[i, j] = 0.0
            p[i, j] = [0.0, 0.0]
            f[i, j] = [0.0, 0.0]

    @ti.kernel
    def to_points():
        for k in x:
            at = x[k] * per_h
            base = int(at + 0.5)
            g = at - base
            w = [0.5 * (0.5 - g) ** 2, 0.75 - g**2, 0.5 * (0.5 + g) ** 2]
            s = [(g - 0.5) * per_h, -2.0 * g * per_h, (g + 0.5) * per_h]
            flow, change = ti.Vector([0.0, 0.0]), ti.Vector([0.0, 0.0])
            L = ti.Matrix.zero(float, 2, 2)
            for a, b in ti.static(ti.ndrange(3, 3)):
                node = base + ti.Vector([a - 1, b - 1])
                flow += w[a][0] * w[b][1] * v_node[node]
                change += w[a][0] * w[b][1] * a_node[node]
                L += v_node[node].outer_product(ti.Vector([s[a][0] * w[b][1], w[a][0] * s[b][1]]))
            x[k] += dt * flow
            v[k] += kick[None] * change
            F[k] = (ti.Matrix.identity(float, 2) + dt * L) @ F[k]
            J = F[k].determinant()
            tau[k] = mu * F[k] @ F[k].transpose() + ti.Matrix.identity(float, 2) * (
                lmbda * ti.log(J) - mu
            )

    x.from_numpy(scene["x"])
    v.from_numpy(scene["v"])
    F.from_numpy(np.tile(np.eye(2), (n, 1, 1)))

    kicks = itertools.chain([0.5 * dt], itertools.repeat(dt))

    def go(steps: int) -> None:
        for now in itertools.islice(kicks, steps):
            kick[None] = now
            to_grid()
            on_grid()
            to_points()
        ti.sync()

    return go, x.to_numpy


PEERS = {"warp": warp_steps, "taichi": taichi_steps}


def neo_hookean(E: float, nu: float) -> dict[str, float]:
    """Lamé's constants (Pa) by name."""
    return {"mu": 0.5 * E / (1 + nu), "lmbda": E * nu / ((1 + nu) * (1 - 2 * nu))}
