"""Problems go on when their points split and merge between steps."""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm

E, RHO, HEIGHT = 1e5, 1000.0, 0.75
LAW = mpm.materials.Hencky(E=E, nu=0.2)
EXPECTED = {"rtol": 0, "atol": 1e-9}


class Block:
    """A block between rollers under a load on its top: its strain is the same everywhere."""

    def __init__(
        self, kind=mpm.QuasiStatic, basis="gimp", law=LAW, load=-1e4, form=None, **options
    ):
        lines = [np.linspace(0, 1, 5), np.linspace(0, 1, 5)]
        self.grid = mpm.create_lattice(MPI.COMM_WORLD, lines)
        self.points = points = mpm.fill(self.grid, mpm.Box((0, 0), (1, HEIGHT)), 2, RHO)
        self.V = V = mpm.Space(self.grid, basis)
        self.top = mpm.Surface(points, lambda x: np.isclose(x[1], HEIGHT), normal=(0, 1))
        self.load = fem.Constant(self.grid, (0.0, load))
        strain = {"strain": form} if form else {}
        F = mpm.momentum(law, points, V.increment, V.test, **strain)
        F += self.top.traction(self.load, V.test)
        self.bcs = mpm.rollers(V, "left", "right", "bottom")
        self.problem = kind(F, V.increment, points, self.bcs, **options)

    def split(self, where=lambda x: x[0] + x[1] < 1.0):
        change = mpm.split(self.points, where)
        assert 0 < change.count < change.before.number
        return change

    def merge(self, tolerance=1e-6):
        change = mpm.merge(self.points, tolerance)
        assert change.count > 0
        return change

    def uniform(self):
        """Mean stretch and stress, which all points must have."""
        for name in ("F", "stress"):
            values = self.points[name]
            size = np.abs(values).max()
            np.testing.assert_allclose(values, values[:1] + 0 * values, rtol=0, atol=1e-7 * size)
        return self.points["F"][0, 1, 1], self.points["stress"][0, 1, 1]


@pytest.mark.parametrize(
    ("kind", "options", "strain"),
    [
        (mpm.QuasiStatic, {}, None),
        (mpm.QuasiStatic, {"stabilisation": "ghost"}, "small"),
        (mpm.QuasiStatic, {"stabilisation": "aggregation"}, "jaumann"),
        (mpm.Transient, {}, None),
        (mpm.Transient, {"error": 1e-2}, None),
    ],
)
def test_a_uniform_state_stays_uniform(kind, options, strain):
    """Parts of GIMP's domains and of faces give what the whole gives."""
    results = []
    for splits in (False, True):
        block = Block(kind, form=strain, **options)
        for k in range(5):
            if splits and k == 2:
                block.split()
            if splits and k == 3:
                block.split(lambda x: x[0] < 0.5)
            if splits and k == 4:
                block.merge()
            block.load.value[1] = -2e3 * (k + 1)
            arguments = (0.1 * (k + 1),) if kind is mpm.Transient else ()
            block.problem.step(*arguments)
        assert block.top.mean_displacement()[1] == pytest.approx(
            (block.uniform()[0] - 1) * HEIGHT, rel=1e-6
        )
        area = np.linalg.norm(block.points[block.top.area.name], axis=1).sum()
        assert area == pytest.approx(1.0, rel=1e-13)
        results.append(block.uniform())
    np.testing.assert_allclose(results[1], results[0], rtol=1e-9)


def test_the_arc_length_goes_on():
    results = []
    for splits in (False, True):
        block = Block(load=-1e3)
        arc = mpm.ArcLength(
            block.problem.form.given, block.V.increment, block.points, block.bcs,
            load=block.load, length=5e-3,
        )  # fmt: skip
        for k in range(4):
            if splits and k == 1:
                block.split()
            if splits and k == 3:
                block.merge()
            arc.step()
        stretch, stress = block.uniform()
        # equilibrium at the load that the path has come to
        assert stress * 1.0 == pytest.approx(block.load.value[1], rel=1e-6)
        results.append(stretch)
    # the length of a step weighs by the points
    assert results[1] == pytest.approx(results[0], rel=1e-2)


DYNAMIC = [
    (mpm.Newmark, {}),
    (mpm.Newmark, {"mass": "lumped", "mapping": "apic"}),
    (mpm.GeneralisedAlpha, {}),
    (mpm.Explicit, {}),
    (mpm.Explicit, {"mapping": "tpic"}),
    (mpm.Explicit, {"mapping": "apic", "fused": False}),
    (mpm.Explicit, {"fused": False}),
]


@pytest.mark.parametrize(("kind", "options"), DYNAMIC)
def test_a_block_that_swings_goes_on(kind, options):
    """A column that swings under a sudden load; splitting changes neither sums nor the motion."""
    swings = []
    for splits in (False, True):
        block = Block(kind, basis="bspline2" if options.get("mapping") == "apic" else "gimp",
                      load=-1e3, **options)  # fmt: skip
        tops, points = [], block.points
        for k in range(16):
            if splits and k in (4, 8):
                change = block.split(lambda x, k=k: x[1] > 0.3 * k / 4)
                if options.get("mapping") != "tpic":
                    assert change.after.kinetic_energy == pytest.approx(
                        change.before.kinetic_energy, rel=1e-12
                    )
                np.testing.assert_allclose(
                    change.after.momentum, change.before.momentum, rtol=1e-12, atol=1e-12
                )
            if splits and k == 12:
                change = mpm.merge(points, 1e-2)
                assert change.count
                np.testing.assert_allclose(
                    change.after.momentum, change.before.momentum, rtol=1e-12, atol=1e-12
                )
            block.problem.step((k + 1) * 0.01)
            tops.append(points["V0"] @ (points["x"] - points["x0"])[:, 1] / points["V0"].sum())
        assert points.error_in_fields() is None
        assert points["V0"] @ points["density"] == pytest.approx(RHO * HEIGHT, rel=1e-13)
        swings.append(tops)
    size = np.abs(swings[0]).max()
    assert size > 1e-3
    np.testing.assert_allclose(swings[1], swings[0], rtol=0, atol=0.02 * size)


@pytest.mark.parametrize(
    ("kind", "options"),
    [(mpm.Newmark, {}), (mpm.Explicit, {}), (mpm.Explicit, {"mapping": "tpic"})],
)
def test_the_energy_that_merging_takes_has_its_name(kind, options):
    """It had been lost in "projection" and "integrator", which judges a run."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [np.linspace(0, 4, 9), np.linspace(0, 4, 9)])
    place = [0.0]

    def size(x):
        return np.where(np.abs(x[0] - place[0]) < 0.9, 0.25, 1.0)

    V = mpm.Space(grid, "gimp", refine=size, levels=1)
    points = mpm.fill(grid, mpm.Box((0, 1), (3.3, 2.2)), 2, RHO)
    law = mpm.materials.VonMises(10 * E, 0.2, yield_stress=1e4)
    F = mpm.momentum(law, points, V.increment, V.test)
    problem = kind(F, V.increment, points, mpm.fixed(V, "left"), **options)
    points["velocity"] = np.outer(2.0 * (points["x"][:, 0] / 3.3) ** 2, (0, 1))
    for k in range(5):
        problem.step(0.01 * (k + 1))
    before, place[0] = problem.energies(), 3.0
    assert problem.adapt().merged > 0
    after = problem.energies()
    lost = before.kinetic + before.strain - after.kinetic - after.strain
    assert abs(lost) > 1e-4 * before.kinetic
    assert after["merging"] - before["merging"] == pytest.approx(lost, rel=1e-9)
    for name in ("plastic", "projection", "integrator"):
        assert after[name] == pytest.approx(before[name], abs=1e-9 * before.kinetic)
    assert after.initial == before.initial
    # the next step finds no change of velocities by hand
    problem.step(0.06)
    assert problem.energies().initial == before.initial


@pytest.mark.parametrize("kind", [mpm.Newmark, mpm.GeneralisedAlpha, mpm.Explicit])
def test_the_energy_that_merging_takes_at_the_start_of_a_step_counts_once(kind):
    """Implicit steps had counted it as a loss of the mapping, too, and as energy of the user."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [np.linspace(0, 4, 9), np.linspace(0, 4, 9)])
    place = [0.0]

    def size(x):
        return np.where(np.abs(x[0] - place[0]) < 2.0, 0.25, 1.0)

    V = mpm.Space(grid, "gimp", refine=size, levels=1)
    points = mpm.fill(grid, mpm.Box((0.5, 1), (2, 2)), 2, RHO, refine=V)
    F = mpm.momentum(mpm.materials.Hencky(100 * E, 0.2), points, V.increment, V.test)
    problem = kind(F, V.increment, points, mass="consistent")
    x = points["x"] - (1.25, 1.5)
    points["velocity"] = np.stack([-x[:, 1], x[:, 0]], axis=1)
    problem.step(0.001)
    before, place[0] = problem.energies(), 5.0
    problem.step(0.002)
    after = problem.energies()
    lost = after["merging"] - before["merging"]
    assert lost > 1e-3 * before.kinetic
    assert problem.history[-1].merged > 5
    assert after.initial == pytest.approx(before.initial, abs=1e-6 * lost)
    assert abs(after["projection"] - before["projection"]) < 0.1 * lost
    kept = before.kinetic + before.strain - after.kinetic - after.strain
    assert kept == pytest.approx(lost, rel=0.1)


def test_contact_of_points_that_the_steps_split_is_no_energy_of_the_user():
    """What the contact of new corners stores more had counted as first energy: 5 % of the work."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [np.arange(-2.0, 3), np.arange(0.0, 5)])
    tool = mpm.RigidBody(mpm.Box((-0.49, 2.0), (0.71, 3.4)), velocity=(0.8, -1.8), fillet=0.1)
    points = mpm.fill(grid, mpm.Box((-1.37, 0), (1.62, 2)), 2, 1800.0)
    V = mpm.Space(grid, "gimp", refine=mpm.where_it_yields(points, 0.25), levels=2)
    u, v = V.increment, V.test
    law = mpm.materials.VonMises(2e6, 0.3, yield_stress=16e3)
    F = mpm.momentum(law, points, u, v) + mpm.contact(tool, points, u, v, friction=0.3)
    problem = mpm.Newmark(F, u, points, mpm.fixed(V, "bottom"), stabilisation="ghost")
    records = [problem.step(t) for t in mpm.times(0.1, dt=0.025)]
    assert sum(record.split for record in records) > 0
    e = problem.energies()
    assert e.external > 1e4
    assert abs(e.initial) < 1e-9 * e.external
    whole = e.kinetic + e.strain + e.contact + e.dissipated
    assert whole == pytest.approx(e.external, rel=1e-9)
