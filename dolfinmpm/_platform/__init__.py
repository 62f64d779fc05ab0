"""What lies beneath: versions, start-up, errors, abort, compile caches, the report on a system."""
