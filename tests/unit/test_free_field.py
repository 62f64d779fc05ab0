"""Free-field sides: level ground moves as its column, and waves of a body leave."""

from __future__ import annotations

import functools

import numpy as np
import pytest
import ufl
from conftest import COMM

import dolfinmpm as mpm
from dolfinmpm._platform.errors import ParameterError

H, SIZE, ALPHA = 12.0, 1e-4, 0.5
# ways to step: basis, mass, length of the wave, and the largest shares of the peak by which the
# velocities are off those of the exact layer and of the column
WAYS = {
    "newmark": (mpm.Newmark, "bspline2", "consistent", 12.0, 0.01, 0.002),
    "alpha": (mpm.GeneralisedAlpha, "bspline2", "consistent", 12.0, 0.02, 0.02),
    "explicit": (mpm.Explicit, "gimp", "consistent", 20.0, 0.03, 0.02),
    "lumped": (mpm.Explicit, "gimp", "lumped", 60.0, 0.05, 0.025),
}


def pulse(t, length):
    """Velocity of the wave (m/s): a smooth pulse."""
    return SIZE * np.sin(np.pi * t / length) ** 2 if 0.0 < t < length else 0.0


def exact(y, t, wave):
    """Velocity of a layer on rock: T Σ rⁿ [w(t − y − 2nH) + w(t − (2H − y) − 2nH)], c_s = 1."""
    through, back = 2.0 / (1.0 + ALPHA), (ALPHA - 1.0) / (ALPHA + 1.0)
    return sum(
        through * back**n * (wave(t - y - 2 * n * H) + wave(t - 2 * H + y - 2 * n * H))
        for n in range(3)
    )


def ground(first, width, kind, sides, base=None, hill=None, basis="bspline2", **more):
    """Ground with ρ = 1, E = 2, ν = 0, so that c_s = 1 and c_p = √2, in the middle of a grid.

    `sides` are a column, or the period of tied sides.
    """
    top = H if hill is None else H + 3
    lines = [np.arange(first // 1 - 3, first + width + 4), np.arange(top + 1)]
    grid = mpm.create_lattice(COMM, lines)
    body = mpm.Box((first, 0), (first + width, H))
    points = mpm.fill(grid, body if hill is None else body | hill, 2, 1.0)
    V = mpm.Space(grid, basis)
    F = mpm.momentum(mpm.materials.Hencky(E=2.0, nu=0.0), points, V.increment, V.test)
    bcs = mpm.fixed(V, "bottom") if base is None else base(V)
    if isinstance(sides, mpm.GroundColumn):
        bcs += mpm.free_field(V, "left", "right", column=sides)
    else:
        more["prolongation"] = mpm.tied(V, period=sides)
    return points, kind(F, V.increment, points, bcs, **more)


def rock(wave):
    """A base of rock through which a wave comes in."""
    speeds = {"density": 1.0, "p_speed": np.sqrt(2.0) / ALPHA, "s_speed": 1.0 / ALPHA}
    return lambda V: mpm.absorbing(V, "bottom", **speeds, incoming=(wave, None))


def column_of(mass, end, dt, base=None, basis="gimp"):
    """The motion of a column of the ground."""
    options = {"ghost_mass": 0.0} if mass == "consistent" else {}
    _, problem = ground(0.0, 1.0, mpm.Newmark, 1.0, base, basis=basis, mass=mass, **options)
    return mpm.GroundColumn(problem, end, dt=dt)


@pytest.mark.parametrize(
    ("way", "first"),
    [
        ("newmark", 0.5), ("alpha", 0.5), ("explicit", 0.0), ("lumped", 0.5),
        pytest.param("newmark", 0.0, marks=pytest.mark.long),
    ],
)  # fmt: skip
def test_level_ground_moves_as_the_exact_layer(way, first):
    kind, basis, mass, length, by_exact, by_column = WAYS[way]
    wave = functools.partial(pulse, length=length)
    end, dt = 26.0 + length, 0.2
    column = column_of(mass, end, dt, rock(wave), basis)
    points, problem = ground(first, 4.0, kind, column, rock(wave), basis=basis, mass=mass)
    peak, most, off = 2.0 * SIZE * 2.0 / (1.0 + ALPHA), 0.0, 0.0
    for t in mpm.times(end, dt=dt):
        record = problem.step(t)
        # explicit velocities are half a step behind
        at = t - 0.5 * record.dt if kind is mpm.Explicit else t
        y, v = points["x0"][:, 1], points["velocity"]
        most = max(most, np.abs(v[:, 0] - [exact(one, at, wave) for one in y]).max())
        of_column = np.interp(y, column.height, column.at(at)[1][:, 0])
        off = max(off, np.abs(v[:, 0] - of_column).max(), np.abs(v[:, 1]).max())
    assert most < by_exact * peak
    assert off < by_column * peak
    energies = problem.energies()
    kept = energies.kinetic + energies.strain + energies.losses["damping"]
    assert kept == pytest.approx(energies.external, rel=1e-3)


def test_waves_of_a_hill_leave_where_tied_sides_keep_them():
    hill, left = mpm.Box((5, H), (9, H + 2)), []
    for sides in (column_of("consistent", 60.0, 1.0), 14.0):
        points, problem = ground(
            0.0, 14.0, mpm.Newmark, sides, hill=hill, basis="gimp", ghost_mass=1e-3
        )
        points["velocity"][points["x"][:, 1] > H] = (SIZE, 0.0)
        first = problem.energies().kinetic
        for t in mpm.times(60.0, dt=0.5):
            problem.step(t)
        now = problem.energies()
        left.append((now.kinetic + now.strain) / first)
    assert left[0] < 0.05
    assert left[1] > 0.85


def test_a_stress_at_rest_is_in_balance_with_that_of_the_column():
    """Ground with weight: its sides carry the horizontal stress of the column."""
    law, stress = mpm.materials.Hencky(E=2e3, nu=0.25), mpm.geostatic_stress(4.0, 10.0, 0.5)

    def layer(width, **options):
        grid = mpm.create_lattice(COMM, [np.arange(width + 5), np.arange(5.0)])
        points = mpm.fill(grid, mpm.Box((2, 0), (2 + width, 4)), 2, 1.0)
        V = mpm.Space(grid, "gimp")
        F = mpm.momentum(law, points, V.increment, V.test)
        F -= ufl.inner(points.density * ufl.as_vector((0.0, -10.0)), V.test) * points.dX
        mpm.set_stress(law, points, stress)
        return points, V, F

    points, V, F = layer(1)
    sides = {"prolongation": mpm.tied(V, period=1.0), "ghost_mass": 0.0}
    problem = mpm.Newmark(F, V.increment, points, mpm.fixed(V, "bottom"), **sides)
    column = mpm.GroundColumn(problem, 1.0, dt=0.1)
    points, V, F = layer(4)
    bcs = mpm.fixed(V, "bottom") + mpm.free_field(V, "left", "right", column=column)
    problem = mpm.Newmark(F, V.increment, points, bcs)
    for t in mpm.times(1.0, dt=0.1):
        problem.step(t)
    assert np.abs(points["x"] - points["x0"]).max() < 1e-9
    assert np.abs(points["velocity"]).max() < 1e-9


def test_bad_arguments():
    column = column_of("lumped", 0.4, 0.2)
    grid = mpm.create_lattice(COMM, [range(5), range(13)])
    points = mpm.fill(grid, mpm.Box((1, 0), (3, H)), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    u, F = V.increment, mpm.momentum(mpm.materials.Hencky(2.0, 0.0), points, V.increment, V.test)
    with pytest.raises(ParameterError, match="'bottom' is not vertical"):
        mpm.free_field(V, "bottom", column=column)
    with pytest.raises(ParameterError, match=r"mpm.GroundColumn"):
        mpm.free_field(V, "left", column=3.0)
    with pytest.raises(ParameterError, match="must be a problem in time"):
        mpm.GroundColumn(mpm.QuasiStatic(F, u, points, mpm.fixed(V, "bottom")), 1.0, dt=0.1)
    bcs = mpm.free_field(V, "left", column=column)
    with pytest.raises(ParameterError, match="constraints between nodes would drop the pushes"):
        mpm.Explicit(F, u, points, bcs, stabilisation="aggregation")
    problem = mpm.Newmark(F, u, points, mpm.fixed(V, "bottom") + bcs)
    problem.step(0.4)
    with pytest.raises(ParameterError, match=r"t = 0.6 s is after the end .* 0.4 s"):
        problem.step(0.6)
    solid = mpm.Space(mpm.create_lattice(COMM, [range(3)] * 3), "gimp")
    with pytest.raises(ParameterError, match="same dimension"):
        mpm.free_field(solid, "left", column=column)


def test_a_column_of_other_heights_or_times_is_refused():
    """Half a column would push half a side, and one of later times would push before it moved."""
    column = column_of("lumped", 0.4, 0.2)
    grid = mpm.create_lattice(COMM, [range(7), range(15)])
    for top in (8, 14):
        points = mpm.fill(grid, mpm.Box((1, 0), (3, top)) | mpm.Box((3, 0), (6, H)), 2, 1.0)
        V = mpm.Space(grid, "gimp")
        F = mpm.momentum(mpm.materials.Hencky(2.0, 0.0), points, V.increment, V.test)
        # the other side fits
        mpm.Newmark(F, V.increment, points, mpm.free_field(V, "right", column=column))
        message = f"from 0 to {top} m high at the free-field side 'left', .* from 0 to 12 m"
        with pytest.raises(ParameterError, match=message):
            mpm.Newmark(F, V.increment, points, mpm.free_field(V, "left", column=column))
    _, problem = ground(0.0, 1.0, mpm.Newmark, 1.0, basis="gimp", ghost_mass=0.0)
    problem.step(0.4)
    late = mpm.GroundColumn(problem, 0.8, dt=0.2)
    _, problem = ground(0.0, 4.0, mpm.Newmark, late, basis="gimp")
    with pytest.raises(ParameterError, match=r"t = .* s is before the start .* 0.4 s"):
        problem.step(0.2)
