"""Areas in the plane: polygons with holes, their files, distances to their borders, and ways in them.

A file that cannot be read, a shape without an area, a point outside and a grid with too many points raise a
ValueError, whose message is one line. Docstrings say so only where there is more to say.
"""
