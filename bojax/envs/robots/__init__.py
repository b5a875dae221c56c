"""Environments of robots that MJX simulates."""
