"""Claims of the thesis: their statistical tests on the results of a sweep, and the page of all verdicts.

A test is a module with a function of the results and of the settings of the test, whose schema in `settings`
names that function as its `target`: the report imports it from there, see `bojax.report.findings`. The page
over several results folders is `bojax.claims.reproduction`.
"""
