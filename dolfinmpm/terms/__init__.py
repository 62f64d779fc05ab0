"""Everything that acts on a body is a term: its forces, its tangent, and what it keeps."""
