"""The learned driver rookie; see ``CARD.md``."""
