"""Programs that make drivers better: tuning and learning. None of them is a driver itself."""

__all__: list[str] = []
