"""The planner of the heuristic and the learned drivers, for any number of karts at once.

Ten times per second it lists what each kart can do in the next two seconds (:mod:`.plans`): which
lane to drive in, whether to brake, when to drift and for how long. It simulates all plans on the
road ahead, in arcs or with a network that has learned how karts move (:mod:`.motion`), and assigns
each a worth in meters (:mod:`.worth`). Boosts and items increase the worth; the edge of the road
and slower karts ahead decrease it. :class:`PlanDriver` keeps the karts' state between steps and
converts a policy's choices among the best plans to controls.

It was developed on the training tracks of :mod:`stkzoo.tracks` only. An evolution strategy tuned
most of its parameters there (:mod:`stkzoo.agents.training.tune_plans`).
"""

__all__: list[str] = []
