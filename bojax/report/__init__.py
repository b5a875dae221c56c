"""Reports: a results folder in, figures, claims with verdicts and one self-contained page out.

`bojax.report.build.build_report` is the way in. Nothing here imports JAX or runs an experiment, and
everything written is derived: it can be rebuilt from the tables at any time.
"""
