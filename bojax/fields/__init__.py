"""Fields: scalar functions of the plane that a robot monitors, and the files of their values.

A file that cannot be read or holds other data raises a ValueError: one line, which names the file where its
name is known. Docstrings say so only where there is more to say.
"""
