"""`bojax.part` builds every part from its schema, and parts in it from names, mappings and objects."""

from typing import Any

import jax.numpy as jnp
import numpy as np

import bojax
from bojax.config.catalog import kinds, roles
from bojax.config.component import import_target
from bojax.fields.base import Field
from tests.parts import REQUIRED
from tests.refusals import assert_refused


class Slope(Field):
    def __call__(self, x):
        return x[0]


def test_every_part_is_built_with_its_defaults(data_files):
    for role in roles():
        for kind, schema in kinds(role).items():
            part = bojax.part(kind, role=role, **REQUIRED.get(kind, {}))
            assert type(part) is import_target(schema.target), kind


def test_settings_are_numbers_names_mappings_and_parts():
    nested = {"kind": "scaled", "variance": np.float64(2.0), "kernel": {"kind": "rbf", "lengthscale": 0.5}}
    given = bojax.part("kcbts", iterations=7, kernel=nested, motions="kernel")
    built = bojax.part(
        "kcbts",
        iterations=np.int64(7),
        kernel=bojax.part("scaled", variance=2, kernel=bojax.part("rbf", lengthscale=jnp.asarray(0.5))),
        motions=bojax.part("kernel"),
    )
    assert given.iterations == built.iterations == 7
    assert float(given.kernel.kernel.lengthscale) == float(built.kernel.kernel.lengthscale) == 0.5
    own = bojax.part("planning", problem={"kind": "monitoring", "field": Slope()}, planner="sbo")
    assert isinstance(own.problem.field, Slope) and own.planner.discount.dtype == jnp.float64
    episodes = bojax.part("learning", env=bojax.part("chain", dtype="float32"), learner="additive")
    assert episodes.learner.learning_rate.dtype == jnp.float32  # the setting `dtype` of the experiment


def test_mistakes_are_one_line(usual_jax):
    half: Any = "float16"
    mistakes = (
        (lambda: bojax.part("emuq"), 'got "emuq"; unknown part; .* did you mean "emu-q"'),
        (lambda: bojax.part("kcbt", role="planner"), 'unknown planner; allowed: .* did you mean "kcbts"'),
        (lambda: bojax.part("constant"), "^constant: needs a role; allowed: mean, schedule$"),
        (lambda: bojax.part("emu-q", kapa=2.0), '^learner.kapa: unknown key; .* did you mean "kappa"'),
        (lambda: bojax.part("emu-q", kappa=-1), "^learner.kappa: got -1; allowed: >= 0$"),
        (lambda: bojax.part("learning", learner="emu-q"), "^env: missing; this setting has no default$"),
        (
            lambda: bojax.part("kcbts", motions=bojax.part("splines")),
            "^planner.motions: got .*; not allowed here; allowed: cubic, kernel$",
        ),
        (lambda: bojax.part("monitoring", field=bojax.part("sbo")), "^problem.field: got .*; unknown field"),
        (lambda: bojax.part("kcbts", kernel="mine:Mine"), "planner.kernel: got mine:Mine; allowed: a name"),
        (lambda: bojax.part("sbo", dtype="float64"), "JAX runs without 64-bit numbers"),
        (lambda: bojax.part("sbo", dtype=half), 'dtype: got "float16"; allowed: "float64" or "float32"'),
    )
    assert_refused(mistakes, bojax.BojaxError)
    assert bojax.part("sbo").discount.dtype == jnp.float32
