"""Support for all other folders: versions, start-up, errors, abort, compile caches, bug reports."""
