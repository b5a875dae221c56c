"""Import of the modules that a sweep names, with JAX prepared for the user's code. Imports JAX only then."""

from bojax.config.external import imports_code, resolve
from bojax.config.points import Sweep
from bojax.engine.signals import kept


def resolved(sweep: Sweep) -> Sweep:
    """The sweep with its import paths resolved.

    Raises:
        ConfigError: A module or a class cannot be used.
    """
    if not imports_code(sweep):
        return sweep
    with kept():
        from bojax.engine.devices import prepare

        prepare(sweep.engine.device)
        return resolve(sweep)
