"""The decision process: observations, rewards, actions and endings, in plain numpy.

Every part sees the whole race at once, as arrays with a leading axis of karts or agents.
"""
