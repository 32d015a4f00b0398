"""The learned driver zenith; see ``CARD.md``."""
