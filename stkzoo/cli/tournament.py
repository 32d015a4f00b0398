"""``stkzoo tournament``."""


def add_parser(subparsers):
    subparsers.add_parser("tournament")
