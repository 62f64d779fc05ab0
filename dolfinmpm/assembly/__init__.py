"""Assembly: terms at the points, over the grid, over facets of splines, and means over cells."""
