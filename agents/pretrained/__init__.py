"""Learned drivers, each a package named as it is raced: ``stkzoo race pretrained:NAME``.

A package has ``weights.safetensors`` (a network of two layers), ``card.json`` (the weights'
digest, how they were learned, what they reach, where they fail), and the words of an agent
(:mod:`stkzoo.agents`). ``python -m stkzoo.agents.training.export`` makes one.
"""

__all__: list[str] = []
