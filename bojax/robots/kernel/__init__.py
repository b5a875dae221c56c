"""Functions of small arrays, such as steps of MJX, as one kernel on a GPU; small matrices without a library.

See docs/robot-simulation.md.
"""
