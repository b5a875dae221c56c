"""Launchers: how workers are started on other machines."""
