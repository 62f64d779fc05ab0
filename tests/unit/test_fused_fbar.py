"""Fused loops: changes of volume that points of a cell share."""

from __future__ import annotations

import numpy as np
import pytest
from test_fused import CORNER, HENCKY, LONG, STEEL, compare, problem

import dolfinmpm as mpm
from dolfinmpm.materials import MohrCoulomb

LOOSE = MohrCoulomb(1e5, 0.3, 0.0, 22.0)

SHARED = [
    {"basis": "gimp", "scheme": "musl", "law": LOOSE},
    {"basis": "linear", "scheme": "usl", "law": HENCKY},
    {"basis": "bspline2", "averaged": False, "scheme": "usl", "law": HENCKY, "strain": "small"},
    {"basis": "bspline2", "averaged": True, "scheme": "musl", "law": HENCKY, "domains": "fixed"},
    {"basis": "bspline3", "averaged": False, "scheme": "usf", "law": HENCKY, "strain": "jaumann",
     "mapping": "apic"},
    {"basis": "bspline3", "averaged": True, "scheme": "usl", "law": HENCKY, "power": 1.3},
]  # fmt: skip


@pytest.mark.parametrize(
    "scene",
    [pytest.param(s, marks=[] if k < 1 else [pytest.mark.long]) for k, s in enumerate(SHARED)],
    ids=lambda s: "-".join(str(x) for x in s.values())[:40],
)
def test_shared_changes_of_volume(scene):
    one = compare(fbar=True, body=CORNER, **scene)
    if scene.get("strain", "large") == "large":
        J = np.linalg.det(one.points["F"])
        assert np.abs(one.points["J_bar"] / J - 1.0).max() > 1e-6


SOLID = mpm.Box((-1, -1, -1), (0.6, 0.43, 0.4))

SHARED_IN_SPACE = [
    {"basis": "linear", "scheme": "usl", "law": HENCKY},
    {"basis": "gimp", "scheme": "musl", "law": LOOSE, "power": 1.3},
    {"basis": "bspline2", "averaged": False, "scheme": "usl", "law": HENCKY, "strain": "small"},
    {"basis": "bspline2", "averaged": True, "scheme": "usf", "law": HENCKY, "strain": "jaumann"},
    {"basis": "bspline3", "averaged": False, "scheme": "musl", "law": HENCKY, "mapping": "apic"},
    {"basis": "gimp", "scheme": "usl", "law": HENCKY, "by": "centres"},
]


@pytest.mark.parametrize(
    "scene",
    [pytest.param(s, marks=[LONG] * (k > 0)) for k, s in enumerate(SHARED_IN_SPACE)],
    ids=lambda s: "-".join(str(x) for x in s.values())[:40],
)
def test_shared_changes_of_volume_in_three_dimensions(scene):
    scene = dict(scene)
    by = scene.pop("by", True)
    one = compare(fbar=by, body=SOLID, d=3, courant=0.1, **scene)
    if scene.get("strain", "large") == "large":
        J = np.linalg.det(one.points["F"])
        assert np.abs(one.points["J_bar"] / J - 1.0).max() > 1e-6


BY_CENTRES = [
    {"basis": "gimp", "scheme": "usl", "law": STEEL, "power": 1.3},
    {"basis": "gimp", "scheme": "usf", "law": STEEL, "strain": "small"},
    {"basis": "linear", "scheme": "musl", "law": LOOSE, "strain": "jaumann", "mapping": "apic"},
]


@pytest.mark.parametrize(
    "scene",
    [pytest.param(s, marks=LONG) for s in BY_CENTRES],
    ids=lambda s: "-".join(str(x) for x in s.values())[:40],
)
def test_changes_of_volume_shared_by_centres(scene):
    one = compare(fbar="centres", body=CORNER, **scene)
    if scene["basis"] == "gimp":
        # domains reach into the next cells, with shares that means by domains count
        other = problem(fbar=True, body=CORNER, **scene)
        for record in one.history:
            other.step(record.time)
        a, b = (p.points["stress"][np.argsort(p.points["id"])] for p in (one, other))
        assert np.abs(a - b).max() > 1e-6 * np.abs(a).max()
