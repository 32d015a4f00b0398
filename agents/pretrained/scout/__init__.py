"""The learned driver *scout*; see ``CARD.md``."""
