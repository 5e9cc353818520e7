"""The worlds, one a file; import them from `sim`."""
