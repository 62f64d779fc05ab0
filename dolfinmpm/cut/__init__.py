"""Cut cells: what is active, fill fractions, aggregation, unknowns, stabilisations."""
