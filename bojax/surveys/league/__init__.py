"""League of surveys: routes of several planners on the same fields, from the same starts."""
