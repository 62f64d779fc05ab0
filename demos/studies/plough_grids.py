"""Grids of `plough.py`: graded lines that follow the plough, or cells that are fine around it."""

from __future__ import annotations

import math

import numpy as np

import dolfinmpm as mpm

# Growth of the cells with distance, and thickness of the layer of equal cells by h
GROWTH, REACH = 0.5, 2.0


def roots(args, bed):
    """Levels of halving, and lines of cells as large as the share is deep, or so.

    Args:
        args: Options of `plough.py`.
        bed: Length, width and depth of the bed (m).
    """
    levels = max(0, round(math.log2(args.depth / args.h)))
    size = args.h * 2**levels
    length, width, depth = (math.ceil(a / size - 1e-9) for a in bed)
    above = math.ceil(1.5 * args.depth / size - 1e-9)
    counts = (0, length), (0, width), (-depth, above)
    return levels, [size * np.arange(a, b + 1) for a, b in counts]


def near_share(plough, args):
    """Sizes of cells around the share, wherever it is."""
    h = args.h
    return mpm.near(plough, h * (1 + 1e-4), reach=REACH * h, growth=GROWTH)


def beside(x, half, share, start):
    """Points of sand beside the share, up to its front: their x and half-lengths.

    A point that the front cuts, or nearly touches, ends there.

    Args:
        x, half: Positions and half-lengths of points as if there were no share (m), shape (n, 3).
        share: The share.
        start: Where its nose is (m).
    """
    low, high = x - half, x + half
    some = 1e-9 * share.d
    apart = (low[:, 1] > share.w - some) | (high[:, 2] < some - share.d)
    apart |= high[:, 0] < start + share.back + some
    front = start + share.front(low[:, 1], low[:, 2])
    ahead = ~apart & (x[:, 0] > front + some)
    cut = ahead & (low[:, 0] < front + half[:, 0])
    low[cut, 0] = front[cut]
    kept = apart | ahead
    return 0.5 * (low + high)[kept], 0.5 * (high - low)[kept]
