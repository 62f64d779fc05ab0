"""Loads that jump at the start of a step in time."""

from __future__ import annotations

from conftest import COMM
from dolfinx import fem, mesh

from dolfinmpm.solve.loads import Loads


def test_a_step_that_failed_is_no_former_change():
    """The next call with the same jump has the same answer."""
    load = fem.Constant(mesh.create_unit_square(COMM, 1, 1), 0.0)
    loads = Loads([load], [])
    load.value = 1.0
    loads.set_target()
    assert loads.jumps()
    assert loads.change == [1.0]
    loads.set(0.0)
    loads.accept(whole=False)
    assert loads.change == []
    load.value = 1.0
    loads.set_target()
    assert loads.jumps()
    loads.accept()
    load.value = 3.0
    assert not loads.jumps()
