"""State problems of the literature on online POMDP solvers."""
