"""How a robot follows a path in the world: exactly, or as its physics and its controller do."""
