"""The elasto-plastic collapse of AMPLE (Coombs & Augarde 2020), and a slope that fails."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import figures_of
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm.solve.newton import Newton


@pytest.fixture(scope="module")
def collapse():
    """The published scene as it stands."""
    return figures_of("demos/studies/elastoplastic_collapse.py", "--json", "-", "--no-plot")


def test_few_newton_iterations(collapse):
    assert collapse["points"] == 9216
    assert len(collapse["iterations"]) == 40
    assert max(collapse["iterations"]) <= 8
    assert collapse["halvings"] == 0


def test_newton_converges_quadratically(collapse):
    orders = np.array(collapse["newton_orders"])
    assert orders.size >= 20
    assert np.median(orders) >= 1.9
    # some steps end before the last points have settled whether they yield
    assert np.mean(orders > 1.5) >= 0.9


def test_the_weight_does_the_work_that_is_stored_and_dissipated(collapse):
    assert 0 < collapse["energy_gap"] < 0.005
    energy = collapse["energy"]
    assert energy["dissipated"] > 10 * energy["stored"] > 0


@pytest.mark.long
def test_smaller_steps_and_cells_end_in_the_same_shape(collapse):
    # with these points and 80 steps the run does not come to its end without stabilisation
    options = "--json - --no-plot --points-per-cell 3 --stabilisation ghost"
    script = "demos/studies/elastoplastic_collapse.py"
    small = figures_of(script, *options.split(), "--steps", "80")
    fine = figures_of(script, *options.split(), "--h", "0.25")
    for other in (small, fine):
        assert other["runout"] == pytest.approx(collapse["runout"], rel=0.08)
        assert other["height"] == pytest.approx(collapse["height"], rel=0.05)
    assert abs(small["energy_gap"]) < collapse["energy_gap"]


def test_a_second_line_search_is_tried_and_kept(monkeypatch):
    """Where full Newton steps fail the step is repeated with the other search, not halved."""
    attempt = Newton._attempt
    tried = []

    def cycles_with_full_steps(self, operator, outcome, guess=None):
        tried.append(self.search)
        attempt(self, operator, outcome, guess)
        if self.search == "basic":
            outcome.reason = "cycles"

    monkeypatch.setattr(Newton, "_attempt", cycles_with_full_steps)
    grid = mesh.create_unit_square(MPI.COMM_WORLD, 4, 4, mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 0.5)), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    g = fem.Constant(grid, (0.0, 0.0))
    F = mpm.momentum(mpm.materials.Hencky(E=1e3, nu=0.3), points, V.increment, V.test)
    F -= ufl.inner(points.density * g, V.test) * points.dX
    problem = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))
    for load in (1.0, 2.0):
        g.value[1] = -load
        problem.step()
    assert tried == ["basic", "cp", "cp"]
    assert all(record.halvings == 0 for record in problem.history)
    assert points["stress"][:, 1, 1].min() < -0.5


def test_a_line_search_of_the_user_stays():
    options = {"petsc_options": {"snes_linesearch_type": "bt"}, "options_prefix": "mpm_bt_"}
    grid = mesh.create_unit_square(MPI.COMM_WORLD, 4, 4, mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 0.5)), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    F = mpm.momentum(mpm.materials.Hencky(E=1.0, nu=0.0), points, V.increment, V.test)
    bcs = mpm.fixed(V, "bottom")
    assert mpm.QuasiStatic(F, V.increment, points, bcs, **options).newton.searches == ()
    # what one problem tries must not pass for what the user of the next has chosen
    for _ in range(2):
        problem = mpm.QuasiStatic(F, V.increment, points, bcs)
        assert problem.newton.searches == ("basic", "cp")
