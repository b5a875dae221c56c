"""Experiments: pure descriptions of a run that the engine can batch, pause and stop."""
