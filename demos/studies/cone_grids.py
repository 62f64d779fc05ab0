"""Grids of `cone_penetration.py`: graded, or cells that are fine around the tip alone."""

from __future__ import annotations

import math

import numpy as np
from grids import growing

import dolfinmpm as mpm

# Growth of the cells with distance, and thickness of the layer of equal cells by R. With a layer of
# R, cells of R/16 are twice as many; the force differs by 0.2 % in clay, by 2.4 % in sand.
GROWTH, REACH = 0.35, 0.25


def graded(args):
    """Lines across and up: cells of h around the cone and along its way, which grow from there."""
    R, h = args.radius, args.h
    fine = h * np.arange(math.ceil(args.zone * R / h - 1e-9) + 1)
    across = np.append(fine, fine[-1] + growing(h, args.width - fine[-1], args.growth))
    last, first = -args.depth - 2 * R, min(0.0, -args.start + R * math.sqrt(3.0) + R)
    zone = first - h * np.arange(math.ceil((first - last) / h - 1e-9) + 1)[::-1]
    under = zone[0] - growing(h, args.width, args.growth)[::-1]
    up = np.concatenate([under, zone, growing(h, -first, args.growth) + first])
    # room for ground that heaves
    room = (up[-1] - up[-2]) * np.arange(1, 1 + (4 if first == 0.0 else 1))
    return across, np.append(up, room + up[-1])


def roots(args):
    """Levels of halving, and lines of a grid of cells of 2 R or so, across and up."""
    levels = max(0, round(math.log2(2 * args.radius / args.h)))
    size = args.h * 2**levels
    across = size * np.arange(math.ceil(args.width / size - 1e-9) + 1)
    below = math.ceil((args.depth + args.width / 2) / size - 1e-9)
    up = size * np.arange(-below, 2)
    return levels, across, up


def near_tip(cone, args):
    """Sizes of cells around the conical part of the penetrometer, wherever it is."""
    R, tip = args.radius, -args.start
    height = R * math.sqrt(3.0)
    if args.dimension == "3":
        part = mpm.Cone((0.0, 0.0, tip), R, 30.0, height + 0.5 * R)
    else:
        top = tip + height
        side = [(R, top), (R, top + 0.5 * R)]
        part = mpm.Polygon([(0.0, tip), *side, *((-r, z) for r, z in side[::-1])])
    return mpm.near(cone, args.h * (1 + 1e-4), reach=REACH * R, growth=GROWTH, part=part)
