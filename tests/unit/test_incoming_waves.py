"""Waves that come in through absorbing sides, against the exact waves in a layer."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from conftest import COMM

import dolfinmpm as mpm
from dolfinmpm._platform.errors import ParameterError

H, SIZE = 20.0, 1e-4
# ways to step, which all take the same waves
WAYS = {
    "newmark": functools.partial(mpm.Newmark, mass="consistent", ghost_mass=0.0),
    "alpha": functools.partial(mpm.GeneralisedAlpha, mass="consistent", ghost_mass=0.0),
    "explicit": functools.partial(mpm.Explicit, mass="consistent", ghost_mass=0.0),
    "lumped": functools.partial(mpm.Explicit),
    "apic": functools.partial(mpm.Explicit, mapping="apic"),
}


def pulse(t, length=12.0):
    """Velocity of the wave (m/s): a smooth pulse."""
    return SIZE * np.sin(np.pi * t / length) ** 2 if 0.0 < t < length else 0.0


def layer(way, axis=0, rock=1.0, wave=pulse):
    """A layer on an elastic half-space, ρ = 1, E = 2, ν = 0, so that c_s = 1 and c_p = √2."""
    grid = mpm.create_lattice(COMM, [np.arange(8.0), np.arange(H + 1)])
    points = mpm.fill(grid, mpm.Box((3, 0), (4, H)), 2, 1.0)
    V = mpm.Space(grid, "bspline2")
    F = mpm.momentum(mpm.materials.Hencky(E=2.0, nu=0.0), points, V.increment, V.test)
    p, s = rock * np.sqrt(2.0), rock
    incoming = None
    if wave is not None:
        incoming = (wave, None) if axis == 0 else (None, wave)
    bcs = mpm.absorbing(V, "bottom", density=1.0, p_speed=p, s_speed=s, incoming=incoming)
    sides = mpm.tied(V, period=1.0)
    return points, WAYS[way](F, V.increment, points, bcs, prolongation=sides)


@pytest.mark.parametrize(
    ("way", "axis"),
    [
        pytest.param(
            way, axis,
            marks=[pytest.mark.long]
            * (way == "lumped" or (axis == 1 and way not in ("newmark", "explicit"))),
        )
        for way in WAYS
        for axis in (0, 1)
    ],
)  # fmt: skip
def test_a_wave_goes_up_and_comes_back(way, axis):
    """Of shear or of pressure: w(t − y/c) goes up, and w(t − (2H − y)/c) comes back."""
    c = (1.0, np.sqrt(2.0))[axis]
    # with a lumped mass the speed of a wave depends more on its length
    length = 60.0 if way in ("lumped", "apic") else 12.0
    wave = functools.partial(pulse, length=length)
    points, problem = layer(way, axis, wave=wave)
    most = 0.0
    for t in mpm.times(12.0 + length, dt=0.1):
        problem.step(t)
        y = points["x0"][:, 1]
        exact = np.array([wave(t - a / c) + wave(t - (2 * H - a) / c) for a in y])
        most = max(most, np.abs(points["velocity"][:, axis] - exact).max())
    # explicit velocities are half a step late
    assert most < (0.02 if way in ("newmark", "alpha") else 0.05) * SIZE
    # the wave's work is what the layer has, and what has left
    energies = problem.energies()
    kept = energies.kinetic + energies.strain + energies.losses["damping"]
    few = {"newmark": 1e-8, "explicit": 1e-3, "lumped": 5e-3}.get(way, 3e-2)
    assert kept == pytest.approx(energies.external, rel=few)


@pytest.mark.parametrize("way", ["newmark", "explicit"])
def test_all_that_came_in_leaves(way):
    """After the wave the layer stands still, moved by twice the displacement of the wave."""
    points, problem = layer(way)
    for t in mpm.times(60.0, dt=0.2):
        problem.step(t)
    assert np.abs(points["velocity"]).max() < 1e-2 * SIZE
    moved = points["x"] - points["x0"]
    assert moved[:, 0] == pytest.approx(2 * 6.0 * SIZE, rel=5e-3)
    energies = problem.energies()
    assert energies.losses["damping"] == pytest.approx(energies.external, rel=1e-3)


@pytest.mark.parametrize(
    ("way", "wave"),
    [
        ("explicit", pulse),
        ("lumped", None),
        pytest.param("explicit", None, marks=pytest.mark.long),
        pytest.param("lumped", pulse, marks=pytest.mark.long),
    ],
)
def test_stiff_sides_make_no_energy(way, wave):
    """A rock ten times as stiff: dashpots are large beside the mass of the nodes in a step."""
    points, problem = layer(way, rock=10.0, wave=wave)
    points["velocity"][:, 0] = SIZE * np.sin(0.5 * np.pi * points["x"][:, 1] / H)
    first = problem.energies().kinetic
    before = np.inf
    for t in mpm.times(50.0, dt=2.0):
        problem.step(t)
        now = problem.energies()
        if t > 20.0:
            assert now.kinetic + now.strain < 1.001 * before
            before = now.kinetic + now.strain
    came = first + now.external
    assert now.losses["damping"] + before == pytest.approx(came, rel=1e-2)


def test_the_wave_is_half_the_motion_of_an_outcrop():
    """A record as incoming wave: a half-space without a layer moves by twice the wave."""
    t = np.linspace(0.0, 12.0, 200)
    record = mpm.InputMotion(t, velocity=[pulse(one) for one in t])
    points, problem = layer("newmark", wave=record.scaled(0.5))
    top = points["x0"][:, 1] > H - 0.5
    found = []
    for at in mpm.times(34.0, dt=0.1):
        problem.step(at)
        found.append(points["velocity"][top, 0].mean() - record(at - H))
    assert np.abs(found).max() < 0.02 * SIZE


@pytest.mark.parametrize(
    ("incoming", "message"),
    [
        (pulse, "must be one velocity per direction"),
        ((pulse,), r"incoming=\(record, None\)"),
        ((1.0, None), "incoming = 1.0 must be a function"),
        ((lambda t: "a", None), "incoming"),
        ((None, pulse), "p_speed = 0 m/s gives the side no dashpots"),
    ],
)
def test_waves_that_cannot_come_in(incoming, message):
    V = mpm.Space(mpm.create_lattice(COMM, [range(4), range(4)]))
    with pytest.raises(ParameterError, match=message):
        mpm.absorbing(V, "bottom", density=1.0, p_speed=0.0, s_speed=1.0, incoming=incoming)


def test_waves_take_the_general_steps():
    grid = mpm.create_lattice(COMM, [range(5), range(5)])
    points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    V = mpm.Space(grid, "gimp")
    F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, V.increment, V.test)
    ground = {"density": 2000.0, "p_speed": 26.0, "s_speed": 14.0}
    bcs = mpm.absorbing(V, "bottom", **ground, incoming=(None, pulse))
    assert mpm.Explicit(F, V.increment, points, bcs).unfused == "waves come in through a side"
    assert not mpm.Explicit(F, V.increment, points, mpm.absorbing(V, "bottom", **ground)).unfused
    with pytest.raises(ParameterError, match="leave out collision= or incoming="):
        mpm.Explicit(F, V.increment, points, bcs, collision=mpm.Collision(tags=(0, 1)))
