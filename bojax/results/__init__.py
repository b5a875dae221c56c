"""File formats of a results folder: schemas, atomic writes and merging. Imports no JAX."""
