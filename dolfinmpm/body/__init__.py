"""The body: material points and where they come from, shapes, location, migration, surfaces."""
