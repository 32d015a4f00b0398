"""A league of players that learn against each other's past selves."""

__all__: list[str] = []
