"""Films and stills of recorded runs, drawn from the files of a results folder, without JAX.

The entry point is `bojax.films.choose.choose_film`. Robots are rendered by MuJoCo, without a screen.
"""
