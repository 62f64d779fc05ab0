"""The background mesh as material points see it: lattice, numbering, overlap of ranks."""
