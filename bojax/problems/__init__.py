"""Problems: the world, the belief about it, and what is scored."""
