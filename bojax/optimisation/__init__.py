"""Optimisation of a plain function over numbers, integers and choices."""
