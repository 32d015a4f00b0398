"""Learned drivers, each a package that you can race with ``stkzoo race pretrained:NAME``.

A package contains ``weights.safetensors`` (the network), ``card.json`` (the digest of the weights,
training, results and limits), and the functions of an agent (:mod:`stkzoo.agents`). ``python -m
stkzoo.agents.training.export`` makes one.
"""
