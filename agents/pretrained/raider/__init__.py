"""The learned driver raider; see ``CARD.md``."""
