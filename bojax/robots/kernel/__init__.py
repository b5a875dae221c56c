"""Steps of MJX as one kernel on a GPU, and small matrices without a library: see docs/robot-simulation.md."""
