"""`bojax.part`: any part as an object, from its schema, with defaults."""

from typing import Any, Literal

import jax.numpy as jnp

from bojax.api.errors import BojaxError, in_one_line
from bojax.config.catalog import kinds, named, roles
from bojax.config.errors import LIST, allowed_names, dotted, shown
from bojax.engine.build import build


def part(
    kind: str,
    /,
    *,
    role: str | None = None,
    dtype: Literal["float64", "float32"] | None = None,
    **settings: Any,
) -> Any:
    """Build a part: a planner, a learner, a problem, an environment, a model, an acquisition function, ...

    The names, settings and defaults are those of configuration files; `bojax list NAME` prints them. A
    setting that holds a part takes a name, a mapping of `kind` and settings, or an object: a part built
    before, or one of a class of your own that derives from the base class of the role.

    Args:
        kind: Name of the part, such as `"emu-q"`.
        role: Role of the part, such as `"schedule"`; needed only for a name that several roles have.
        dtype: Precision of its numbers; by default the one of JAX, or for an experiment its setting `dtype`.
        settings: Settings that differ from the defaults: `part("emu-q", kappa=2.0)`.

    Raises:
        BojaxError: There is no such part or precision, a setting is wrong, or `dtype` is float64 and JAX
            runs without 64-bit numbers; the message is one line.
    """
    if dtype not in (None, "float64", "float32"):
        raise BojaxError(f'dtype: got {shown(dtype)}; allowed: "float64" or "float32"')
    with in_one_line():
        owners = [each for each in roles() if kind in kinds(each) and role in (None, each)]
        if not owners:
            known = {name for each in roles() if role in (None, each) for name in kinds(each)}
            raise BojaxError(f"got {shown(kind)}; unknown {role or 'part'}{allowed_names(kind, known, LIST)}")
        if len(owners) > 1:
            raise BojaxError(f"{kind}: needs a role; allowed: {', '.join(owners)}")
        component = named(owners[0], {"kind": kind, **settings})
        own: Any = getattr(component, "dtype", jnp.result_type(float).name)
        above = () if component.role == "experiment" else (component.role,)
        return build(component, dtype or own, lambda location: dotted((*above, *location)))
