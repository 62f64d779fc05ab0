"""The body: material points, shapes and filling, location, migration, domains, surfaces."""
