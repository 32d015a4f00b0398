"""Reference algorithms for the tasks of :mod:`stkzoo.suite`: ``stkzoo suite train``."""
