"""Faults by the thousand: what is killed, stopped, cut off and filled up, and what remains."""
