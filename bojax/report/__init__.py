"""Reports: figures, verdicts on claims and one self-contained page, made from a results folder.

The entry point is `bojax.report.build.build_report`. Reports import no JAX and run no experiment. They can
be rebuilt from the tables at any time.

What reads or writes a file raises `bojax.results.store.ResultsError` if the file is missing, damaged, cannot
be written or lacks what is asked for: one line, which names the file. A figure that the results do not allow
raises `FigureUnavailable`, a test of a claim `Undecidable`, with the reason. Docstrings say so only where
there is more to say.
"""
