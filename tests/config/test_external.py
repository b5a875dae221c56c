"""A class given by import path is imported, checked and validated, and is then an ordinary component."""

import sys

import pytest

from bojax.config.component import External
from bojax.config.errors import ConfigError
from bojax.config.external import imports_code, resolve
from bojax.config.sweep import load_config, load_sweep
from tests.transcript import cases

MODULE = '''
"""Kernels of a user."""

from typing import Literal

import equinox as eqx
import gymnasium
import jax.numpy as jnp
import pydantic
from jaxtyping import Array, Float

from bojax.models.kernels import Kernel


class Annotated(Kernel):
    """A kernel whose settings are the annotated arguments of its constructor."""

    lengthscale: Float[Array, ""]
    weights: Float[Array, "3"] = (1, 2.5, 3)
    either: Float[Array, ""] | Float[Array, "D"] = 2
    order: int = eqx.field(static=True, default=3)
    mode: Literal["sum", "product"] = eqx.field(static=True, default="sum")
    names: tuple[str, ...] = eqx.field(static=True, default=())
    table: Float[Array, "2"] = eqx.field(default_factory=lambda: jnp.ones(2))

    def __call__(self, x, y):
        return jnp.zeros(())


class Configured(Kernel):
    lengthscale: Float[Array, ""]

    class Config(pydantic.BaseModel):
        lengthscale: float = pydantic.Field(3.0, gt=0)

    def __call__(self, x, y):
        return jnp.zeros(())


class Checking(Kernel):
    class Config(pydantic.BaseModel):
        @pydantic.model_validator(mode="before")
        @classmethod
        def check(cls, settings):
            return settings["lengthscale"]

    def __call__(self, x, y):
        return jnp.zeros(())


class Nested(Kernel):
    inner: Kernel

    def __call__(self, x, y):
        return jnp.zeros(())


class Fieldless(Kernel):
    lengthscale: eqx.AbstractVar[Float[Array, ""]]

    def __call__(self, x, y):
        return jnp.zeros(())


class Lacking(eqx.Module):
    lengthscale: float


class Registered(gymnasium.Env):
    pass


number = 3
'''


@pytest.fixture
def resolved(write, monkeypatch):
    """Resolves a config whose kernel is given by import path."""
    write("my_kernels.py", MODULE)
    write("my_broken.py", "import math\n\nmath.sqrt(-1)\n")
    write("my_script.py", "import sys\n\nsys.exit(0)\n")
    write("my_quitter.py", "class Quit(BaseException):\n    pass\n\n\nraise Quit\n")
    write("my_needy.py", "import there_is_no_such_module\n")
    write("x.yaml", "planner: {kind: kcbts, kernel: {kind: 'my_kernels:Annotated', lengthscale: 2}}")
    monkeypatch.setattr(sys, "path", [*sys.path])
    for name in [name for name in sys.modules if name.startswith("my_")]:
        del sys.modules[name]
    return lambda *overrides: resolve(load_config("x.yaml", overrides)).points[0]


def test_nothing_is_imported_before_it_is_resolved(resolved):
    sweep = load_config("x.yaml")
    assert imports_code(sweep) and "my_kernels" not in sys.modules
    assert isinstance(sweep.points[0].config.planner.kernel, External)
    assert not imports_code(resolve(sweep)) and "my_kernels" in sys.modules


SAVED = "results/mine/learners/0/experiment.yaml"


def test_a_module_that_a_saved_learner_names_is_printed_before_it_is_imported(resolved, write, capsys):
    kernel = "planner: {kind: kcbts, kernel: {kind: 'my_noisy.deep:Mine'}}"
    write("my_noisy/__init__.py", "import sys\nprint('runs', file=sys.stderr)\n")
    deep = write("my_noisy/deep.py", "from my_kernels import Configured as Mine\n")
    write(SAVED, kernel)
    resolve(load_config("results/mine/learners/0"))
    assert capsys.readouterr().err == (
        f"importing my_noisy.deep ({deep}), named in {SAVED}: planner.kernel.kind\nruns\n"
    )


def test_a_gymnasium_id_of_a_saved_learner_is_printed(resolved, write, capsys):
    module = write("my_envs.py", "import gymnasium\n")
    write(SAVED, "{experiment: learning, env: {kind: gymnasium, id: 'my_envs:Mine-v0'}, learner: emu-q}")
    sweep = load_config(SAVED)
    assert imports_code(sweep)
    resolve(sweep)
    assert capsys.readouterr().err == f"importing my_envs ({module}), named in {SAVED}: env.id\n"
    assert not imports_code(load_config(SAVED, ["env.id=MountainCarContinuous-v0"]))


def test_a_folder_whose_name_looks_like_a_setting_hides_no_module(resolved, write, capsys):
    config = "planner: {kind: kcbts, kernel: {kind: 'my_kernels:Configured'}}"
    saved = write("mine: x/experiment.yaml", config)
    resolve(load_config(str(saved)))
    assert capsys.readouterr().err.startswith("importing my_kernels (")


def test_nothing_is_printed_without_a_module_or_for_one_that_the_user_names(resolved, write, capsys):
    """In a config of their own, or on the command line, even where it replaces that of a saved learner."""
    for id in (":Mine-v0", ".my_envs:Mine-v0", "my_nothing:Mine-v0"):  # left to Gymnasium
        write(SAVED, f"{{experiment: learning, env: {{kind: gymnasium, id: '{id}'}}, learner: emu-q}}")
        resolve(load_config(SAVED))
    resolved()
    write(SAVED, "planner: {kind: kcbts, kernel: {kind: 'my_other:Mine'}}")
    resolve(load_config(SAVED, ["planner.kernel=my_kernels:Configured"]))
    assert capsys.readouterr().err == ""


def test_settings_from_annotations(resolved):
    kernel = resolved("planner.kernel.names=[a, b]").config.planner.kernel
    assert kernel.model_dump(mode="json", exclude={"table"}) == {
        "kind": "my_kernels:Annotated",
        "lengthscale": 2.0,
        "weights": [1, 2.5, 3],
        "either": 2,
        "order": 3,
        "mode": "sum",
        "names": ["a", "b"],
    }
    assert (kernel.role, kernel.target, kernel.label) == ("kernel", kernel.kind, "Annotated")
    assert kernel.constructor_defaults == {"table"}


def test_settings_from_a_nested_config(resolved):
    assert resolved("planner.kernel=my_kernels:Configured").config.planner.kernel.lengthscale == 3.0


def test_the_label_of_a_class_is_its_name(write, resolved):
    write("s.yaml", "{base: x.yaml, axes: {planner.kernel: {mine: {}, rbf: {}}}}")
    sweep = resolve(load_sweep("s.yaml"))
    assert [point.variant for point in sweep.points] == ["mine", "rbf"]
    assert sweep.points[0].config.planner.kernel.label == "Annotated"


REFUSED = """\
planner.kernel.lengthscale=a
=> planner.kernel.lengthscale: got "a"; allowed: a number
planner.kernel.weights=[1, a]
=> planner.kernel.weights: got [1, "a"]; allowed: a number or a list
planner.kernel.weights=[1, .nan]
=> planner.kernel.weights: got [1, NaN]; allowed: a number or a
planner.kernel.order=1.5
=> planner.kernel.order: got 1.5; allowed: an integer
planner.kernel.mode=x
=> planner.kernel.mode: got "x"; allowed: "sum" or "product"
planner.kernel.wieghts=1
=> planner.kernel.wieghts: unknown key; allowed: either, lengthscale, mode
planner.kernel=my_kernels:Annotated
=> planner.kernel.lengthscale: missing; this setting has no default
planner.kernel={kind: 'my_kernels:Configured', lengthscale: 0}
=> got 0; allowed: > 0
planner.kernel=my_kernels:Anotated
=> my_kernels has no Anotated; did you mean "Annotated"?
planner.kernel=my_kernels:number
=> number is not a class
planner.kernel=my_kernel:X
=> module my_kernel is neither in the working directory (
planner.kernel=my_kernels.x:X
=> module my_kernels.x is neither in the working directory (
planner.kernel=my_broken:X
=> importing my_broken failed: ValueError: math domain error (my_broken.py
planner.kernel=my_script:X
=> importing my_script failed: SystemExit: 0 (my_script.py, line 3)
planner.kernel=my_quitter:X
=> importing my_quitter failed: Quit (my_quitter.py, line 5)
planner.kernel=my_kernels:Checking
=> checking its settings failed: KeyError: 'lengthscale' (my_kernels.py, line
planner.kernel=my_needy:X
=> importing my_needy failed: ModuleNotFoundError: No module named 'there
planner.kernel=my_kernels:Nested
=> the annotation of inner in Nested is not the type of a setting; allowed:
planner.kernel=my_kernels:Lacking
=> the class does not implement __call__; see bojax.models.kernels.Kernel
planner.kernel=my_kernels:Fieldless
=> the class does not implement lengthscale; see my_kernels.Fieldless
planner.kernel=my_kernels:Registered
=> does not implement __call__; a class of Gymnasium is registered there, and given by kind=gymnasium
planner.kernel=my_kernels:Annotated
=> missing; this setting has no default; a new kind discards the settings of the old one
"""


def test_refused(resolved):
    for override, message in cases(REFUSED):
        with pytest.raises(ConfigError) as raised:
            resolved(override)
        text = str(raised.value)
        assert text.startswith("command line: planner.kernel") and message in text and "\n" not in text


def test_an_error_in_a_file_names_the_file(write, resolved):
    write("x.yaml", "planner: {kind: kcbts, kernel: {kind: 'my_kernels:Annotated', lengthscale: a}}")
    with pytest.raises(ConfigError, match='^x.yaml: planner.kernel.lengthscale: got "a"; allowed: a number$'):
        resolved()
