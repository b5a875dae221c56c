"""Running sweeps and reading results from Python and notebooks; `import bojax` gives its functions."""
