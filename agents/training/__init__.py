"""Programs that train and tune drivers."""

__all__: list[str] = []
