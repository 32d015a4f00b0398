"""The planner of the heuristic driver and of the learned ones, for any number of karts at once.

Ten times a second it lists what each kart can do in the next two seconds (:mod:`.plans`): which
lane to drive in, whether to brake, when to drift and for how long. It drives all plans over the
road ahead by a simple model of a kart, and weighs them in metres of way (:mod:`.worth`): boosts and
items count, and so do the edge of the road and slower karts ahead. :class:`PlanDriver` holds what
karts remember between steps and turns a policy's choices among the best plans into controls.

It was built on the training tracks of :mod:`stkzoo.tracks` alone, and an evolution strategy found
most of its numbers there (:mod:`stkzoo.agents.training.tune_plans`).
"""

__all__: list[str] = []
