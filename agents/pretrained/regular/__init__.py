"""The learned driver regular; see ``CARD.md``."""
