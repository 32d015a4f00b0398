"""Self-play with PPO over plans, in many parallel races."""
