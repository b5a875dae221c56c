"""The engine: batches an experiment over runs and hyper-parameters, compiles it once, drives it to disk."""
