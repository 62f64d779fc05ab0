"""Cut cells: what is active, fill fractions, aggregation, prolongation, unknowns, remedies."""
