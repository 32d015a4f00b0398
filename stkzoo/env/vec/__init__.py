"""Vector environments of many races, with one slot per agent."""
