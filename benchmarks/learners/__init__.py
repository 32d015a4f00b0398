"""How much of the engine's rate a learner reaches."""
