"""Fields: scalar functions of the plane that a robot monitors."""
