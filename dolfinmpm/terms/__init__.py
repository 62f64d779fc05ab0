"""Terms: everything that acts on a body, with forces, tangent and state."""
