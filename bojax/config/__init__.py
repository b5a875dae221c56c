"""Reading configurations: schemas, YAML files, overrides, sweeps and their errors. Imports no JAX."""
