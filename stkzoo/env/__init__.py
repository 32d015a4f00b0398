"""The environments: the parallel core and the views derived from it."""

__all__: list[str] = []
