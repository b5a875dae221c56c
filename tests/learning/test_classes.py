"""A class is abstract or final, so that a method is looked up in one place."""

import importlib
import inspect
import pkgutil

import equinox as eqx
import pytest

import bojax.experiments
import bojax.learning


def classes(*packages) -> list[type]:
    """The modules that are defined in some packages."""
    names = [
        module.name
        for package in packages
        for module in pkgutil.iter_modules(package.__path__, package.__name__ + ".")
    ]
    found = {
        value
        for name in names
        for value in vars(importlib.import_module(name)).values()
        if inspect.isclass(value) and issubclass(value, eqx.Module) and value.__module__ == name
    }
    return sorted(found, key=lambda cls: cls.__qualname__)


ALL = classes(bojax.learning, bojax.experiments)


@pytest.mark.parametrize("cls", ALL, ids=lambda cls: cls.__qualname__)
def test_what_can_be_constructed_has_no_subclass(cls):
    assert inspect.isabstract(cls) or not [other for other in ALL if issubclass(other, cls) and other != cls]


@pytest.mark.parametrize("cls", ALL, ids=lambda cls: cls.__qualname__)
def test_only_defaults_of_an_interface_are_overridden_and_only_once(cls):
    for name, value in vars(cls).items():
        if name.startswith("__") or not (inspect.isfunction(value) or isinstance(value, property)):
            continue
        overridden = [
            base
            for base in cls.__mro__[1:]
            if base in ALL
            and name in vars(base)
            and not getattr(vars(base)[name], "__isabstractmethod__", False)
        ]
        assert all(base.__bases__ == (eqx.Module,) for base in overridden), name
        assert len(overridden) <= 1, name
