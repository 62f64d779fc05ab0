"""Places without a node, and what the message tells of them."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import unit_grid

import dolfinmpm as mpm
from dolfinmpm._platform.errors import ParameterError


def told(basis, x):
    V = mpm.Space(unit_grid("quadrilateral", 4), basis)
    with pytest.raises(ParameterError, match="chooses no node") as error:
        mpm.prescribed(V, lambda at: np.isclose(at[0], x), 0)
    return str(error.value)


def test_quadratic_splines_have_no_node_on_a_grid_line():
    assert "middles of cells" in told("bspline2", 0.5)
    V = mpm.Space(unit_grid("quadrilateral", 4), "bspline2")
    assert mpm.prescribed(V, lambda at: np.isclose(at[0], 0.375), 0)


@pytest.mark.parametrize("basis", ["linear", "gimp", "bspline3"])
def test_other_bases_have(basis):
    assert "splines" not in told(basis, 0.45)
    V = mpm.Space(unit_grid("quadrilateral", 4), basis)
    assert mpm.prescribed(V, lambda at: np.isclose(at[0], 0.5), 0)
