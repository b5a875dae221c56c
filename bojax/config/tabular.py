"""Settings of the environments with numbered states, and of the learners that keep a table."""
