"""From settings to modules with strongly typed leaves."""

from typing import Annotated, ClassVar, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import pytest
from jaxtyping import Array, Float

from bojax.config.component import Component, External, Slot
from bojax.config.errors import ConfigError
from bojax.engine.build import build
from bojax.models.settings import RBF


class Inner(eqx.Module):
    scale: Float[Array, ""]


class Outer(eqx.Module):
    inner: Inner
    weight: Float[Array, ""]
    corner: Float[Array, "2"]
    flag: Array
    limit: Float[Array, ""] | None
    count: int = eqx.field(static=True)
    sizes: tuple[int, ...] = eqx.field(static=True)
    mode: str = eqx.field(static=True)

    def __check_init__(self):
        if self.count > 9:
            raise ValueError("count is at\nmost 9")


class OwnConstructor(eqx.Module):
    values: Float[Array, "N"]  # noqa: F821

    def __init__(self, count: int):
        self.values = jnp.zeros(count)


class Raising(eqx.Module):
    """A user's class whose constructor fails, or ends the program."""

    scale: float

    def __init__(self, scale: float):
        if scale == 0:
            raise SystemExit(0)
        if scale < 0:
            raise GeneratorExit
        raise RuntimeError(f"no\nscale {scale}")


class Named(eqx.Module):
    """A class whose message begins with the name of the setting."""

    def __init__(self, size: int):
        raise ValueError(f"size: got {size}; allowed: > 0")


class Holder(eqx.Module):
    inner: Named


class Plain(eqx.Module):
    """A user's class annotated with plain numbers."""

    scale: float
    count: int


class InnerSettings(Component, frozen=True):
    role: ClassVar[str] = "test-inner"
    target: ClassVar[str] = f"{__name__}:Inner"
    kind: str = "inner"
    scale: float = 2.0


class OuterSettings(Component, frozen=True):
    role: ClassVar[str] = "test-outer"
    target: ClassVar[str] = f"{__name__}:Outer"
    kind: str = "outer"
    dtype: Literal["float64", "float32"] = "float64"
    inner: Annotated[Component, Slot("test-inner")] = InnerSettings()
    weight: float = 3
    corner: tuple[float, ...] = (1, 2.5)
    flag: bool = True
    limit: float | None = None
    count: int = 4
    sizes: tuple[int, ...] = (1, 2)
    mode: str = "fast"


class OwnSettings(Component, frozen=True):
    target: ClassVar[str] = f"{__name__}:OwnConstructor"
    kind: str = "own"
    count: int = 4


class ShortSettings(Component, frozen=True):
    target: ClassVar[str] = f"{__name__}:Inner"
    kind: str = "short"


class WrongSettings(Component, frozen=True):
    target: ClassVar[str] = f"{__name__}:Inner"
    kind: str = "wrong"
    scale: float = 1.0
    scales: float = 1.0


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_numbers_become_strongly_typed_leaves_and_structure_stays(dtype):
    module = build(OuterSettings(), dtype)
    assert isinstance(module, Outer) and isinstance(module.inner, Inner)
    for leaf in (module.weight, module.corner, module.inner.scale):
        assert leaf.dtype == dtype and not leaf.weak_type
    assert (float(module.weight), module.corner.tolist(), float(module.inner.scale)) == (3.0, [1.0, 2.5], 2.0)
    assert module.flag.dtype == bool and module.limit is None
    assert (module.count, module.sizes, module.mode) == (4, (1, 2), "fast")
    assert {type(module.count), *map(type, module.sizes)} == {int}


def test_points_of_a_sweep_share_their_structure():
    first, second = build(OuterSettings(weight=1.0)), build(OuterSettings(weight=2.0))
    assert jax.tree.structure(first) == jax.tree.structure(second)
    assert jax.tree.structure(first) != jax.tree.structure(build(OuterSettings(count=5)))


def test_arguments_that_are_no_fields_stay_python_values():
    assert build(OwnSettings()).values.shape == (4,)


def test_settings_left_to_the_constructor():
    class Defaulted(Component, frozen=True):
        target: ClassVar[str] = f"{__name__}:Inner"
        constructor_defaults: ClassVar[frozenset[str]] = frozenset({"shift"})
        kind: str = "defaulted"
        scale: float = 1.0
        shift: float | None = None

    assert float(build(Defaulted()).scale) == 1.0
    with pytest.raises(ConfigError, match="^shift: not an argument of the constructor of .*:Inner; allowed"):
        build(Defaulted(shift=1.0))


@pytest.mark.parametrize(
    ("component", "message"),
    [
        (OuterSettings(count=10), "outer: count is at most 9"),
        (
            WrongSettings(),
            "scales: not an argument of the constructor of tests.engine.test_build:Inner; allowed",
        ),
        (
            ShortSettings(),
            "scale: required by the constructor of tests.engine.test_build:Inner, but not a setting of Short",
        ),
        (OuterSettings(corner=(1.0, 2.0, 3.0)), "corner: got 3 numbers; allowed: 2 numbers"),
        (OuterSettings(corner=(1.0,)), "corner: got 1 numbers; allowed: 2 numbers"),
        (
            External(kind="a:B", slot="kernel"),
            "kernel: got a:B; allowed: a name, or an object of the class",
        ),
    ],
)
def test_refused(component, message):
    with pytest.raises(ConfigError) as raised:
        build(component)
    assert str(raised.value).startswith(message) and "\n" not in str(raised.value)


def test_a_users_constructor_that_fails():
    class Settings(Component, frozen=True):
        target: ClassVar[str] = f"{__name__}:Raising"
        kind: str = f"{__name__}:Raising"
        scale: float = 2.0

    with pytest.raises(ConfigError) as raised:
        build(Settings())
    message = "its constructor failed: RuntimeError: no scale 2.0 (test_build.py, line "
    assert message in str(raised.value) and "\n" not in str(raised.value)
    with pytest.raises(ConfigError, match="its constructor failed: SystemExit: 0"):
        build(Settings(scale=0.0))
    with pytest.raises(ConfigError, match="its constructor failed: GeneratorExit"):
        build(Settings(scale=-1.0))
    with pytest.raises(RuntimeError):  # of a part of bojax: a bug keeps its traceback
        build(Settings(kind="raising"))


def test_plain_numbers_may_be_swept_too():
    class Settings(Component, frozen=True):
        target: ClassVar[str] = f"{__name__}:Plain"
        kind: str = f"{__name__}:Plain"
        scale: float = 2.0
        count: int = 3

    assert [leaf.shape for leaf in jax.tree.leaves(build(Settings()))] == [(), ()]


def test_a_mistake_deep_inside_names_its_path():
    class Bad(InnerSettings, frozen=True):
        scales: float = 1.0

    with pytest.raises(ConfigError, match="^inner.scales: not an argument"):
        build(OuterSettings.model_construct(**{**dict(OuterSettings()), "inner": Bad()}))


def test_float64_needs_x64():
    with (
        jax.enable_x64(False),
        pytest.raises(ConfigError, match='^dtype: got "float64"; JAX runs without 64-bit'),
    ):
        build(RBF())
    with jax.enable_x64(False):
        assert build(RBF(), "float32").lengthscale.dtype == jnp.float32


def test_a_refused_setting_is_found_where_it_was_given():
    class Settings(Component, frozen=True):
        target: ClassVar[str] = f"{__name__}:Named"
        kind: str = "named"
        size: int = -1

    class Around(Component, frozen=True):
        target: ClassVar[str] = f"{__name__}:Holder"
        kind: str = "around"
        inner: Annotated[Component, Slot("test-inner")] = Settings()

    with pytest.raises(ConfigError) as raised:
        build(Around(), locate=lambda path: f"x.yaml: {'/'.join(map(str, path))}")
    assert str(raised.value) == "x.yaml: inner/size: got -1; allowed: > 0"
