"""The planners in plain NumPy, to be read next to the thesis: what the JAX planners must equal."""
