"""Reading configurations: schemas, YAML files, overrides, sweeps and their errors. Imports no JAX.

What is wrong in a file, an override or a setting raises `bojax.config.errors.ConfigError`: one line, which
names the file and the setting. Docstrings say so only where there is more to say.
"""
