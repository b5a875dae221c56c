"""Claims of the thesis, tested on the results of a sweep."""
