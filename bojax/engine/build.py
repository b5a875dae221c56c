"""The module of an experiment, from its settings and possibly from a saved learner."""

from pathlib import Path
from typing import Any, Literal

import equinox as eqx
import jax

from bojax.config.component import Component
from bojax.config.errors import ConfigError, dotted
from bojax.engine.devices import setting
from bojax.engine.learners import load_learner
from bojax.experiments.settings import Learning
from bojax.numerics.construct import Locate, construct


def build(
    component: Component, dtype: Literal["float64", "float32"] = "float64", locate: Locate = dotted
) -> Any:
    """The module that a component describes, with numbers of `dtype` (see `construct`).

    Messages name a setting as `locate` formats its path.

    Raises:
        ConfigError: A constructor rejects its settings, or `dtype` is float64 and JAX has 64-bit numbers
            disabled.
        ResultsError: A saved learner cannot be read, or does not fit the learner of the config.
    """
    if dtype == "float64" and not setting("jax_enable_x64"):
        raise ConfigError(
            f'{locate(("dtype",))}: got "float64"; JAX runs without 64-bit numbers: '
            'call jax.config.update("jax_enable_x64", True) first, or set dtype to "float32"'
        )
    if isinstance(component, Learning) and component.saved is not None:
        run = build(component.model_copy(update={"saved": None}), dtype, locate)
        # A saved learner has the shapes of one without transitions.
        structure = jax.eval_shape(lambda key: run.new_learner(key, capacity=0), jax.random.key(0))
        state = load_learner(Path(component.saved), component.saved_run, structure)
        return eqx.tree_at(lambda r: r.saved, run, state, is_leaf=lambda x: x is None)
    part = construct(component, dtype, locate)
    return part.fitted() if isinstance(component, Learning) else part
