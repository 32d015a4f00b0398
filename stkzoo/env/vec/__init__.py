"""Vector environments of many races, with one slot per agent."""

__all__: list[str] = []
