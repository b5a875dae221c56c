"""The engine: batches an experiment over runs and hyper-parameters, compiles it and writes its results."""
