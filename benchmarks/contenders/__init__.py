"""The engine, stkzoo and pystk2-gymnasium drive the same race, each in its own interpreter."""
