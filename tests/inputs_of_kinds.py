"""Bad inputs of other kinds than expected: arrays, words, truth values, functions that fail.

As a user writes them; `moreinputs` has the names.
"""

from __future__ import annotations

INPUTS = {
    # -- functions that fail, or take something else
    "mpm.fill(s.grid, mpm.Where(lambda x: x.foo), 2, 1.0)": "Where failed with AttributeError:",
    "mpm.fill(s.grid, mpm.Shape(lambda x: {}['k']), 2, 1.0)": "Shape failed with KeyError: 'k'.",
    "flat().from_boreholes([(0, 0)], [1.0], most=lambda x: 'a')": "most should return numbers of",
    "flat().from_boreholes([(0, 0)], [1.0], most=lambda: 1)": "most failed with TypeError:",
    "mpm.RigidBody(TOOL, velocity=lambda t: (t.foo, 0))":
        "velocity, a function of the time, failed at 0 s with AttributeError:",
    "mpm.RigidBody(TOOL, velocity=lambda t: (None + t, 0))":
        "velocity, a function of the time, failed at 0 s with TypeError:",
    "study.differentiate(lambda: 1, {'E': 1.0})":
        "scene is called with a dict: too many positional",
    "study.calibrate(lambda: 1, {'E': 1.0}, {'u': [1.0]})": "scene is called with a dict: too many",
    "study.sweep(lambda: 1, [1.0])": "scene is called with a float: too many positional arguments",
    "study.calibrate(lambda m: 1, {'E': 1.0}, {'u': [1.0]}, progress=lambda: 1)":
        "progress is called with a dict: too many positional arguments",
    # -- truth values, days, words and masks in place of numbers
    "mpm.Ball((0, True), 1.0) and mpm.Box((False, False), (True, True))":
        "low = (False, False) must be numbers, such as (0.0, 1.0)",
    "mpm.Box(('0', '0'), ('1', '1'))": "low = ('0', '0') must be numbers, such as (0.0, 1.0)",
    "flat().raised(True)": "thickness = True must be numbers",
    "mpm.RigidBody(TOOL, rotation_increment=True)": "rotation_increment = True must be 1 finite",
    "mpm.RigidBody(TOOL, increment=np.ma.masked_array([0.1, 0.2], [True, False]))":
        "must be 2 finite numbers",
    "mpm.RigidBody(TOOL, rotation=lambda t: 1j * t)": "rotation(0) = 0j must be 1 finite numbers",
    "mpm.RigidBody(TOOL, angular_velocity=1e308)": "angular_velocity = 1e+308 must be 1 finite",
    "mpm.RigidBody(TOOL, mass=1.0, inertia=1.0, free=np.eye(3))":
        "must have 3 values True or False",
    "points_at(s, rho=np.datetime64('2020-01-01'))": "density should be numbers of shape (2,), got",
    "soil(s, gravity=np.ma.masked_array([0.0, -9.8], [False, True]))":
        "must be 2 finite numbers (m/s²)",
    "s.top.traction(np.ma.masked_array([0.0, 1.0], [False, True]), s.v)":
        "traction[1] = nan must be finite",
    "s.top.traction(b'ab', s.v)": "traction = a bytes must be numbers, such as (0.0, 1.0)",
    "s.plot(limits=np.ma.masked_array([0.0, 1.0], [True, False]))":
        "limits[0] = nan must be finite",
    "mpm.fill(s.grid, mpm.Box((0, 0), (2, 1)), 2, lambda x: x[0] > -1)":
        "density should return numbers of shape",
    "mpm.Deposit(lambda x: x[0] < 9, [mpm.Layer(-5.0, 17e3, 0.5)]).stress([[0.0], [-1.0]])":
        "surface should return numbers of shape (1,) for positions",
    # -- numbers beyond what computers count
    "mpm.Layer(10**400, 17e3, 0.5)": "is beyond the largest floating point number, 1.8e308 m: give",
    "mpm.Fluid(bulk_modulus=10**400)":
        "is beyond the largest floating point number, 1.8e308 Pa: give",
    "mpm.steps(10**400)": "must be a whole number of at most 9.22337e+18",
    "mpm.times(1e308, dt=1e-300)": "makes inf steps up to 1e+308 s, more than 1e+09",
    "mpm.tied(s.V, 1e308)": "period = 1e+308 m must be a whole number of cells of 0.5 m: take 8 m",
    "flat().section((0, 0), (2, 2), count=10**9)": "must be a whole number of at most 100000",
    "mpm.Boundary.from_side(s.points, 'right', rule=10**9)":
        "must be a whole number of at most 100",
    "mpm.Boundary.from_side(s.points, 'right', spacing=1e-300)":
        "spacing cuts 4 m into 4e+300 pieces",
    "mpm.Boundary.from_level_set(s.points, lambda x: x[0] - 2, subdivisions=10**9)":
        "must be a whole number of at most 100",
    "study.RandomField((0, 0), (1, 1), 1.0, mean=1.0, coefficient=0.1, modes=10**9)":
        "modes = 1000000000 must be a whole number of at most 2500",
    "study.RandomField((0, 0), (1, 1), 1e-300, mean=1.0, coefficient=0.1, modes=2)":
        "which take inf nodes; 2500 is the limit: take a smaller box or longer lengths",
    "study.LogNormal(20e3, 30.0)": "coefficient = 30 must be above 0 and below 10",
    # -- arrays in place of words and of single values
    "mpm.tied(s.V, 1.0, axis=np.eye(2))": "axis = array([[1., 0.],",
    "mpm.tied(s.V, 1.0, axis=0.0)": "axis = 0.0 must be a whole number of at least 0",
    "mpm.tied(s.V, 1.0, axis=2)": "axis = 2 must be a whole number of at most 1",
    "mpm.Boundary.from_side(s.points, 'right', name='')":
        "name = '' must be a word, such as 'wall'",
    "mpm.Boundary.from_side(s.points, 'right', name=np.eye(2))": "must be a word, such as 'wall'",
    "curve()[np.zeros(2)]": "nothing is recorded as array([0., 0.]); there are a, b",
    "curve().plot('b.png', 'a', size=3)": "size = 3 must be two numbers",
    "curve().plot('b.png', 'a', labels=np.eye(2))": "must be a dictionary, name → text",
    "mpm.History().record(a=10**400)": "must be a single number",
    "s.plot(colour=np.zeros(2))": "no field array([0., 0.]) to colour by; there are",
    "s.plot(component=[])": "component = [] does not fit 'stress' of shape (3, 3)",
    "s.plot(component=[[1, 2], [3]])":
        "component = [[1, 2], [3]] must be an array, with rows of one",
    "s.plot(title=3)": "title = 3 must be a str: the text above the picture",
    "s.plot(label=np.zeros(2))": "must be a str: the text beside the colour bar",
    "s.plot(cmap=[])": "cmap = [] must be one of",
    "s.plot(cmap='Viridis')": "cmap = 'Viridis' is 'viridis' in Matplotlib: write it so",
    "mpm.animate(s.points, 'a.gif', cmap='viridus')": 'did you mean "viridis"',
    "mpm.animate(s.points, 'a.gif', rate=0)": "rate = 0 frames per second must be at least 0.001",
    "mpm.Film(s.points, 'a.gif')": "make a film with mpm.animate(points, path)",
    "mpm.steps(3, label=3)": "label = 3 must be a str: the text before the bar",
    "mpm.probe(s.points, (1.0, 0.5))[[1.0]]": "the material points have no field [1.0]; they have",
    "s.points.remove([[True], [True, False]])": "where = [[True], [True, False]] must be an array",
    "s.points.remove(tag=1.5)": "tag = 1.5 must be a whole number from 0",
    "s.points.remove(tag='a')": "tag = 'a' must be a whole number from 0",
    "mpm.split(s.points, [[True], [True, False]])": "must be an array, with rows of one length",
    "points_at(s, tag=[[1, 2], [3]])": "tag = [[1, 2], [3]] must be an array",
    "points_at(s, id=[[1, 2], [3]])": "id = [[1, 2], [3]] must be an array",
    "points_at(s, fields=np.eye(2))": "fields = array([[1., 0.],",
    "points_at(s, fields={'a': [[1, 2], [3]]})": "fields['a'] = [[1, 2], [3]] must be an array",
    "s.points.__setitem__('density', [[1, 2], [3]])":
        "points['density'] = [[1, 2], [3]] must be an",
    "s.points.__setitem__(np.eye(2), 1.0)": "fields go by their names, one at a time",
    "soil(s, permeability=[[1, 2], [3]])": "permeability = [[1, 2], [3]] must be a number (m/s)",
    "mpm.times([[1, 2], [3]])": "time = [1, 2] must be a number (s)",
    # -- studies
    "study.differentiate(lambda m: 1, {'E': 1.0}, scales=3)": "scales = 3 must be a dictionary of",
    "study.Run([], [print], {'u': print})": "problem = None must be a Problem: give a problem of",
    "study.Run(s.solver(), 3, {'u': print})": "steps = 3 must be a list of functions without",
    "study.Run(s.solver(), 'ab', {'u': print})": "steps = 'ab' must be a list of functions without",
    "study.Run(s.solver(), [print], {'u': print}, given='no')":
        "given = 'no' must be True or False",
    "study.LimitState(lambda m: 1, ['u'], {'E': 1.0})":
        "limit = ['u'] must be a str: the name of a",
    "study.monte_carlo(lambda m: 1, {'E': study.Normal()}, None)":
        "limit = None must be a str: the",
    "study.convergence(lambda h: h, [1.0, 0.5], errors=3)": "errors = 3 must be a list of names",
    "study.convergence(lambda h: h, [1.0, 0.5], errors=[3])":
        "errors = [3] must be a list of names",
}  # fmt: skip
