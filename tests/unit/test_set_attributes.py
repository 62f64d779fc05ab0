"""Attributes that a script sets of objects of the library: named errors with a remedy."""

from __future__ import annotations

import copy
import pickle
from dataclasses import FrozenInstanceError

import numpy as np
import pytest
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm import study
from dolfinmpm._platform.errors import ParameterError

GRID = mpm.create_lattice(MPI.COMM_WORLD, [np.arange(5.0), np.arange(5.0)])
POINTS = mpm.fill(GRID, mpm.Box((0, 0), (4, 3)), 2, 1800.0)
V = mpm.Space(GRID, "gimp")
PROBLEM = mpm.QuasiStatic(
    mpm.momentum(mpm.materials.Hencky(1e7, 0.3), POINTS, V.increment, V.test),
    V.increment, POINTS, mpm.fixed(V, "bottom"),
)  # fmt: skip
BODY = mpm.RigidBody(mpm.Ball((2, 2), 0.5), increment=(0, 0))
# what a script makes, an attribute of it, and the remedy
MADE = {
    "Fluid": (mpm.Fluid(), "density"),
    "Layer": (mpm.Layer(0.0, 18e3, K0=0.5), "K0"),
    "Stabilisation": (mpm.Stabilisation("ghost"), "factor"),
    "Mapping": (mpm.Mapping("flip"), "kind"),
    "Collision": (mpm.Collision((1, 2)), "friction"),
    "Normal": (study.Normal(), "mean"),
    "LogNormal": (study.LogNormal(1.0, 0.3), "mean"),
    "Face": (mpm.absorbing(V, "bottom", density=2e3, p_speed=1e3)[0], "density"),
    "Ball": (mpm.Ball((0, 0), 1.0), "low"),
    "Box": (mpm.Box((0, 0), (1, 1)), "high"),
    "Plane": (mpm.Plane((0, 0), (0, 1)), "normal"),
    "Terrain": (mpm.Terrain(([0, 4],), [1.0, 2.0]), "heights"),
    "Near": (mpm.near(BODY, 0.5), "least"),
    "WhereItYields": (mpm.where_it_yields(POINTS, 0.5), "least"),
    "TiedSides": (mpm.tied(V, 1.0), "period"),
    "Probe": (mpm.probe(POINTS, (2, 3)), "place"),
    "History": (mpm.History(), "names"),
}


@pytest.mark.parametrize("kind", MADE)
def test_what_is_read_once(kind):
    thing, name = MADE[kind]
    with pytest.raises(ParameterError, match=f"{name} is .*Make a new {kind} with other arg"):
        setattr(thing, name, 3.0)
    with pytest.raises(ParameterError, match=f"frictoin is no attribute of it.* a new {kind}"):
        thing.frictoin = 3.0


def test_conditions_name_the_constant():
    condition = mpm.prescribed(V, "top", 1, increment=0.0)[0]
    with pytest.raises(ParameterError, match=r"value is read once. Give prescribed a dolfinx\.fem"):
        condition.value = 3.0


def test_results_are_kept_in_variables():
    section = mpm.section_forces(POINTS, (2, 1.5), (0, 1))
    record = PROBLEM.step()
    for thing, name in ((section, "moment"), (record, "iterations")):
        with pytest.raises(ParameterError, match="is a result: keep a value of your own"):
            setattr(thing, name, 0)
    with pytest.raises(ParameterError, match=r"displacement is a result\. Keep a value"):
        MADE["Probe"][0].displacement = (1, 1)


def test_figures_of_a_run_may_be_set():
    run = study.Run(PROBLEM, [PROBLEM.step], {"a": lambda: 1.0})
    run.steps, run.measured = [PROBLEM.step] * 2, {"b": lambda: 2.0}
    assert len(run.steps) == 2
    with pytest.raises(ParameterError, match="mesured is no attribute of it"):
        run.mesured = {}


def test_values_can_be_copied_and_derived():
    fluid = mpm.Fluid(bulk_modulus=2e9)
    assert copy.deepcopy(fluid) == pickle.loads(pickle.dumps(fluid)) == fluid
    assert copy.deepcopy(mpm.Ball((0, 0), 1.0)).volume == pytest.approx(np.pi)

    class Own(mpm.Ball):
        pass

    own = Own((0, 0), 1.0)
    own.colour = "red"
    with pytest.raises(FrozenInstanceError):
        fluid._hidden = 1.0
