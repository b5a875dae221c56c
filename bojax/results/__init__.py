"""File formats of a results folder: schemas, atomic writes, merging. Imports no JAX."""
