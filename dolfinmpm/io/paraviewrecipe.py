"""A program for ParaView that opens a series ready to look at."""

from __future__ import annotations

from typing import Any

__all__ = ["recipe_text"]

_RECIPE = '''"""Opens the series beside this file: pvpython THIS.py last.png draws the last time."""
import os
import sys

from paraview.simple import *

folder = os.path.dirname(os.path.abspath(globals().get("__file__", "here")))
view = GetActiveViewOrCreate("RenderView")
points = PVDReader(FileName=os.path.join(folder, {name!r} + ".pvd"))
if {boxes}:  # each point as its domain, from x - l to x + l
    points = Glyph(Input=points, GlyphType="Box", GlyphMode="All Points", ScaleFactor=2.0)
    points.OrientationArray = ["POINTS", "No orientation array"]
    points.ScaleArray, points.VectorScaleMode = ["POINTS", "l"], "Scale by Components"
shown = Show(points, view)
for part, look in {parts}:
    other = Show(PVDReader(FileName=os.path.join(folder, {name!r} + part)), view)
    other.SetRepresentationType(look)
    ColorBy(other, None)
scene = GetAnimationScene()
scene.UpdateAnimationUsingDataTimeSteps()
scene.GoToLast()
ColorBy(shown, {colour})
shown.RescaleTransferFunctionToDataRange(False, True)
bar = GetScalarBar(GetColorTransferFunction({field!r}), view)
bar.Title, bar.ComponentTitle = {title!r}, {component!r}
shown.SetScalarBarVisibility(view, True)
view.InteractionMode = "2D" if {flat} else "3D"
if not {flat}:
    view.CameraFocalPoint, view.CameraViewUp = [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]
    view.CameraPosition = [-1.0, -2.0, 1.0]
ResetCamera(view)
Render(view)
if sys.argv[-1].endswith(".png"):
    SaveScreenshot(sys.argv[-1], view)
'''


def recipe_text(name: str, field: str, unit: str, component: str, bodies: bool, **is_: Any) -> str:
    """The program: points by a field as boxes 2 l wide or as dots, grid, rigid bodies, camera.

    Args:
        name: Name of the series without ending.
        field, unit: The field for the colours, and its unit.
        component: Name of its component, "" where it has one only.
        bodies: Whether there is a series of rigid bodies.
        is_: `boxes`, whether the files have the field l; `flat`, whether it is in 1D or 2D.
    """
    parts = [("_grid.pvd", "Wireframe")] + [("_bodies.pvd", "Surface")] * bodies
    colour = ("POINTS", field) + (component,) * bool(component)
    title = f"{field} ({unit})" if unit else field
    drawn = {"field": field, "colour": colour, "title": title, "component": component}
    return _RECIPE.format(name=name, parts=parts, **drawn, **is_)
