"""The learned driver *ace*; see ``CARD.md``."""
