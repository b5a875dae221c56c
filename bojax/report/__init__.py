"""Reports: figures, verdicts on claims and one self-contained page, made from a results folder.

The entry point is `bojax.report.build.build_report`. Reports import no JAX and run no experiment. They can
be rebuilt from the tables at any time.
"""
