"""The learned driver hunter; see ``CARD.md``."""
