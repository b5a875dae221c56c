"""A batch experiment engine in JAX for Bayesian optimisation in planning and reinforcement learning.

Importing this package imports no JAX and changes no global flag. Its functions, which
`__init__.pyi` declares, are imported when they are first used.
"""

import importlib
from typing import Any

__version__ = "0.2.0"

_HOMES = {
    "run": "start",
    "sweep": "start",
    "tune": "start",
    "survey": "surveying",
    "SurveyResult": "surveying",
    "minimise": "optimiser",
    "maximise": "optimiser",
    "Optimiser": "optimiser",
    "ObjectiveError": "optimiser",
    "OptimisationResult": "optimisation",
    "Area": "mission",
    "Mission": "mission",
    "Place": "mission",
    "read_place": "mission",
    "part": "parts",
    "load": "results",
    "plot_gp": "plots",
    "plot_search": "plots",
    "Results": "results",
    "TuningResults": "results",
    "Picture": "results",
    "BojaxError": "errors",
    "Interrupted": "errors",
}
"""The module of `bojax.api` that defines each name."""


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"bojax.api.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOMES])
