"""Animations of recorded runs, drawn from the files of a results folder."""
