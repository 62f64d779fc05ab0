"""Small mistakes of scripts: each has a message with the remedy."""

from __future__ import annotations

import re
import warnings

import numpy as np
import pytest
import ufl
from dolfinx import fem
from test_body_records import block

import dolfinmpm as mpm
from dolfinmpm._platform.errors import FormError, IdleConditionWarning, ParameterError

MC = mpm.materials.MohrCoulomb


def test_a_law_lists_its_arguments():
    """Python had proposed "nu" for "su", or nothing."""
    with pytest.raises(ParameterError, match="no argument su; it has E, nu, cohesion"):
        mpm.materials.Tresca(E=1e6, nu=0.45, su=10e3)
    with pytest.raises(ParameterError, match="friction; did you mean friction_angle"):
        MC(30e6, 0.3, cohesion=1e3, friction=32.0)
    with pytest.raises(TypeError, match="friction_angle"):
        MC(30e6, 0.3, cohesion=1e3)


def test_reactions_are_of_the_conditions_of_the_problem():
    points, V, F = block()
    problem = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))
    problem.step()
    with pytest.raises(ParameterError, match=re.escape('mpm.fixed(V, "bottom") made once')):
        mpm.reaction(problem, mpm.fixed(V, "bottom"))


def test_a_form_belongs_to_its_points():
    points, V, F = block()
    grid = points.grid
    other = mpm.fill(grid, mpm.Box((0, 0), (4, 1)), per_cell=2, density=2000.0)
    with pytest.raises(FormError, match="make it anew with these points"):
        mpm.QuasiStatic(F, V.increment, other, mpm.fixed(V, "bottom"))
    plate = mpm.RigidBody(mpm.Plane((0, 2), (0, -1)))
    F += mpm.contact(plate, points, V.increment, V.test)
    with pytest.raises(FormError, match="make it anew with these points"):
        mpm.QuasiStatic(F, V.increment, other, mpm.fixed(V, "bottom"))


@pytest.mark.parametrize(
    ("colour", "component", "advice"),
    [
        ("stress", "yy", r'\(1, 1\) for yy, "mean" or "mises"'),
        ("stress", (1, 3), r"\(1, 1\) for yy"),
        ("displacement", "y", "from 0 to 1, such as 1 for y"),
        ("density", 1, "leave it out"),
    ],
)
def test_a_picture_names_the_components_that_there_are(tmp_path, colour, component, advice):
    points, _, _ = block()
    with pytest.raises(ParameterError, match=advice):
        mpm.plot(points, tmp_path / "block.png", colour, component=component)


def test_points_are_removed_by_booleans():
    points, _, _ = block()
    for where, told in ((np.arange(3), ".*int64"), (mpm.Box((0, 1), (4, 2)), "a Box .*")):
        with pytest.raises(ParameterError, match=rf"where = {told}: compare .*contains"):
            points.remove(where)
    upper = mpm.Box((0, 1), (4, 2))
    assert points.remove(upper.contains(points["x"])).count == 16


def test_a_rigid_body_far_from_the_grid_is_told():
    """A shape in mm touched nothing, without a message."""
    points, V, F = block()
    for low, high, far in (((1e3, 2e3), (2e3, 3e3), True), ((1, 5), (2, 6), False)):
        body = mpm.RigidBody(mpm.Box(low, high), increment=(0, -0.01), name="pile")
        form = F + mpm.contact(body, points, V.increment, V.test)
        problem = mpm.QuasiStatic(form, V.increment, points, mpm.fixed(V, "bottom"))
        if far:
            with pytest.warns(IdleConditionWarning, match=r"'pile' begins .* unit of its lengths"):
                problem.step()
        else:
            problem.step()
        assert np.all(body.force == 0.0)


@pytest.mark.parametrize(
    ("point", "normal", "far"),
    [((0, 300), (0, -1), True), ((0, -300), (0, 1), True), ((0, 9), (0, -1), False)],
)
def test_a_rigid_plane_far_from_the_grid_is_told(point, normal, far):
    points, V, F = block()
    plane = mpm.RigidBody(mpm.Plane(point, normal), increment=(0, 0), name="plane")
    F += mpm.contact(plane, points, V.increment, V.test)
    problem = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        problem.step()
    assert [w.category for w in told] == far * [IdleConditionWarning]


def test_the_density_is_over_first_volumes():
    """Over points.dx the weight of a soft block had fallen by 11 % as it was compressed."""
    points, V, F = block()
    weight = points.density * V.test[1]
    with pytest.raises(FormError, match=r"mass per first volume.*integrate over points\.dX"):
        mpm.QuasiStatic(F + weight * points.dx, V.increment, points, mpm.fixed(V, "bottom"))
    mpm.QuasiStatic(
        F + weight / ufl.det(points.F) * points.dx, V.increment, points, mpm.fixed(V, "bottom")
    )


@pytest.mark.parametrize(
    ("text", "advice"),
    [
        ("x;y;volume;density\n0.3;0.3;0.01;1800\n", "delimiter=';'"),
        ("x;y;volume;density\n0,3;0,3;0,01;1800\n", "delimiter=';'"),
        ("x\ty\tvolume\tdensity\n0.3\t0.3\t0.01\t1800\n", r"delimiter='\\t'"),
        ('x,y,volume,density\n"0,3",0.3,0.01,1800\n', "decimals with a point"),
    ],
)
def test_a_table_with_other_marks_is_told(tmp_path, text, advice):
    points, _, _ = block()
    path = tmp_path / "points.csv"
    path.write_text(text)
    with pytest.raises(ParameterError, match=advice):
        mpm.MaterialPoints.from_csv(points.grid, path)


def test_a_step_is_no_longer_than_the_whole_time():
    """Swapped arguments had been a single step."""
    with pytest.raises(ParameterError, match=r"the order is times\(end, dt\)"):
        list(mpm.times(0.1, 10.0))
    assert list(mpm.times(0.1, 0.2)) == [0.1]


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("Tresca", r"'Tresca': it is mpm\.materials\.Tresca$"),
        ("calibrate", r"it is mpm\.study\.calibrate$"),
        ("Clay", "no attribute 'Clay'$"),
    ],
)
def test_a_name_of_another_module_is_told(name, told):
    with pytest.raises(AttributeError, match=told):
        getattr(mpm, name)


def test_a_component_by_its_letter():
    with pytest.raises(ParameterError, match=r"'y' must be in 0 \.\.\. 1 .* along x\[0\]"):
        mpm.prescribed(block()[1], "top", "y", increment=-0.01)


def test_points_list_their_fields():
    """Python had asked for points[0], and told of that."""
    points, _, _ = block()
    assert "density" in points
    assert "mass" not in points
    assert 0 not in points
    assert ["density"] not in points
    assert list(points) == list(points.fields)
    assert len(points) == len(points["x"])
    for name in points:
        points.add_field(f"{name}_before", points[name].shape[1:])
    assert "stress_before" in points


def test_a_constant_of_ufl_is_no_function_of_positions():
    """UFL had called it, and NumPy had told of an array's truth value."""
    points, V, _ = block()
    grid, box = points.grid, mpm.Box((0, 0), (4, 1))
    constant = fem.Constant(grid, 1000.0)
    for given in (constant, 2.0 * constant, V.increment):
        with pytest.raises(ParameterError, match=r"density = .* is an expression of UFL"):
            mpm.fill(grid, box, 2, given)
        with pytest.raises(ParameterError, match=r"is an expression of UFL: give a number"):
            points.add_field("heat", (), "K", given)


def test_bodies_have_a_sum():
    points, _, _ = block()
    grid = points.grid
    layers = [mpm.fill(grid, mpm.Box((0, k), (4, k + 1)), 2, 1e3, tag=k) for k in (0, 1)]
    assert sum(layers).total == sum(layer.total for layer in layers)
    with pytest.raises(ParameterError, match="points are joined with points only, got 1"):
        1 + points
