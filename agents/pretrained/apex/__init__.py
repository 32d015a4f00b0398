"""The learned driver apex; see ``CARD.md``."""
