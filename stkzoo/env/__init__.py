"""The environments: the parallel core and the views derived from it."""
