"""What the learners share: arguments, logs, many races at once, matches."""

__all__: list[str] = []
