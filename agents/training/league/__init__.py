"""A league of players that train against past selves of all players."""
