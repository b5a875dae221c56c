"""Who learns: learners, the balance of exploration and exploitation, and its schedules."""
