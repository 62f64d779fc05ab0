"""Assembly of terms at the points, over the grid, and over ghost facets of splines."""
