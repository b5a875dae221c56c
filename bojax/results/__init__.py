"""File formats of a results folder: schemas, atomic writes and merging. Imports no JAX.

What reads or writes a file raises `bojax.results.store.ResultsError` if the file is missing, damaged or
changed since it was committed, or cannot be written: one line, which names the file. Docstrings say so only
where there is more to say.
"""
