"""Configuration: schema classes of every part, experiment and sweep files, overrides. Imports no JAX."""
