"""The environments: the parallel environment, and the Gymnasium and vector environments on top."""
