"""A batch experiment engine in JAX for Bayesian optimisation in planning and reinforcement learning.

Importing this package imports no JAX and changes no global flag.
"""

__version__ = "0.1.0"
