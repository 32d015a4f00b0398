"""Reference algorithms for the tasks of :mod:`stkzoo.suite`: ``stkzoo suite train``."""

__all__: list[str] = []
