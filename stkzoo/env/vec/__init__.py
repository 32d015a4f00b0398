"""Many races at once, every agent of every race a slot of one batch."""

__all__: list[str] = []
