"""The examples and the pages that show them."""
