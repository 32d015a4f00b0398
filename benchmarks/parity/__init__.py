"""Races in stkzoo and in pystk2-gymnasium, compared step by step."""
