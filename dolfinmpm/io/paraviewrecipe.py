"""A program for ParaView that opens a series ready to look at."""

from __future__ import annotations

__all__ = ["recipe_text"]

_RECIPE = '''"""Opens the series beside this file: pvpython THIS.py last.png draws the last time."""
import os
import sys

from paraview.simple import *

# `paraview --script` does not tell where this file is: after a move, write its folder here
folder = {folder!r}
if "__file__" in globals():
    folder = os.path.dirname(os.path.abspath(__file__))
series = os.path.join(folder, {name!r})
if not os.path.exists(series + ".pvd"):
    raise FileNotFoundError(series + ".pvd does not exist: write its folder into this program")
view = GetActiveViewOrCreate("RenderView")
view.UseColorPaletteForBackground, view.Background = 0, [1.0, 1.0, 1.0]
points = PVDReader(FileName=series + ".pvd")
if {boxes}:  # each point as its domain, from x - l to x + l
    points = Glyph(Input=points, GlyphType="Box", GlyphMode="All Points", ScaleFactor=2.0)
    points.OrientationArray = ["POINTS", "No orientation array"]
    points.ScaleArray, points.VectorScaleMode = ["POINTS", "l"], "Scale by Components"
shown = Show(points, view, PointSize=6.0)
grid = Show(PVDReader(FileName=series + "_grid.pvd"), view)
grid.SetRepresentationType("Wireframe")
grid.AmbientColor = grid.DiffuseColor = [0.7, 0.7, 0.7]
grid.ColorArrayName = ["POINTS", ""]
scene = GetAnimationScene()
scene.UpdateAnimationUsingDataTimeSteps()
scene.GoToLast()
view.InteractionMode = "2D" if {flat} else "3D"
view.CameraFocalPoint = [0.0, 0.0, 0.0]
view.CameraPosition, view.CameraViewUp = {camera}
ResetCamera(view)  # on points and grid: a body may be much larger
GetActiveCamera().Zoom(0.85)  # room for the bar
if {bodies}:
    bodies = Show(PVDReader(FileName=series + "_bodies.pvd"), view)
    bodies.SetRepresentationType("Surface")
    bodies.ColorArrayName, bodies.LineWidth = ["POINTS", ""], 3.0
    bodies.AmbientColor = bodies.DiffuseColor = [0.3, 0.3, 0.3]
ColorBy(shown, {colour})
shown.RescaleTransferFunctionToDataRange(False, True)
bar = GetScalarBar(GetColorTransferFunction({field!r}), view)
bar.Title, bar.ComponentTitle = {title!r}, {component!r}
bar.Orientation, bar.WindowLocation = "Horizontal", "Lower Center"
bar.TitleColor = bar.LabelColor = view.OrientationAxesLabelColor = [0.0, 0.0, 0.0]
shown.SetScalarBarVisibility(view, True)
Render(view)
if sys.argv[-1].endswith(".png"):
    view.ViewSize = [1200, 900]
    SaveScreenshot(sys.argv[-1], view)
'''


def recipe_text(
    folder: str, name: str, field: str, unit: str, component: str, flat: bool, **is_: bool
) -> str:
    """The program: points by a field as boxes 2 l wide or as dots, grid, rigid bodies, camera.

    Args:
        folder: Absolute path of the folder that the series is in.
        name: Name of the series without ending.
        field, unit: The field for the colours, and its unit.
        component: Name of its component, "" where it has one only.
        flat: Whether the points are in 1D or 2D.
        is_: `boxes`, whether the files have the field l; `bodies`, whether there are rigid bodies.
    """
    colour = ("POINTS", field) + (component,) * bool(component)
    title = f"{field} ({unit})" if unit else field
    camera = ([0, 0, 1], [0, 1, 0]) if flat else ([-1, -2, 1], [0, 0, 1])
    drawn = {"flat": flat, "camera": camera, "field": field, "colour": colour}
    texts = {"folder": folder, "name": name, "title": title, "component": component}
    return _RECIPE.format(**texts, **drawn, **is_)
