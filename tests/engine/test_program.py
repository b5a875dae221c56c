"""Programs are compiled with the options that suit them; loops that XLA reads too early are no graphs."""

from types import SimpleNamespace

import jax
import numpy as np
import pytest

from bojax.engine import program
from bojax.engine.build import build
from bojax.engine.program import GAINS_FROM_GRAPHS, GAINS_FROM_PASSES, Program
from bojax.numerics.lanes import LANES, any_lane, in_own_kernel
from bojax.planning.settings import PFTDPW, POMCPOW, VOMCPOW
from bojax.problems.particles import initial
from bojax.problems.pomdp.settings import VdpTag

DEVICE = jax.devices("cpu")[0]


def test_options_of_the_compiler_are_saved_with_a_program_and_give_way_to_flags_of_the_user(monkeypatch):
    given, of_trees = [], Program.of_trees
    quick, gains = (
        of_trees(lambda x: x + 1, np.zeros(2), gains=gains) for gains in ([], [GAINS_FROM_PASSES])
    )
    made, saved = quick.compile("two", DEVICE), gains.export(DEVICE).serialized()
    monkeypatch.setattr(jax.stages.Lowered, "compile", lambda _, options: given.append(options) or made)
    monkeypatch.delenv("XLA_FLAGS", raising=False)
    for each in (quick, gains, Program.deserialized(saved)):
        each.compile("two", DEVICE)
    monkeypatch.setenv("XLA_FLAGS", "--xla_backend_optimization_level=3")
    quick.compile("two", DEVICE)
    assert all(options.pop("xla_llvm_disable_expensive_passes") for options in given)
    assert given == [*({"xla_backend_optimization_level": level} for level in (1, 3, 3)), {}]


@pytest.mark.parametrize("gains", [[], [GAINS_FROM_GRAPHS]])
def test_no_kernel_on_an_nvidia_gpu_starts_before_the_one_that_it_follows_has_ended(monkeypatch, gains):
    monkeypatch.setattr(program, "_platform_of", lambda _: "cuda")
    monkeypatch.delenv("XLA_FLAGS", raising=False)
    gpu = SimpleNamespace(platform="gpu")
    options = program._options(gpu, gains)
    assert options.pop("xla_gpu_enable_pdl") is False
    assert ["WHILE" in value for value in options.values()] == [True] * len(gains)
    # XLA refuses options that it does not have, whatever the device.
    jax.jit(lambda: 0).lower().compile({"xla_gpu_enable_pdl": False})
    monkeypatch.setenv("XLA_FLAGS", "--xla_gpu_enable_pdl=true")
    assert "xla_gpu_enable_pdl" not in program._options(gpu, gains)


@pytest.mark.parametrize("by_user", [False, True])
@pytest.mark.parametrize("num_lanes, has_kernel", [(1, False), (1, True), (2, False)])
def test_a_loop_on_a_flag_of_its_carry_is_no_graph(monkeypatch, num_lanes, has_kernel, by_user):
    """In XLA, the kernel that reads such a condition of a graph does not wait for what has computed it."""

    def halved(x):
        def goes_on(carry):
            turn, _, flag = carry
            return any_lane(in_own_kernel(flag, turn) if has_kernel else flag)

        def halve(carry):
            turn, x, _ = carry
            return turn + 1, x / 2, x > 4

        return jax.lax.while_loop(goes_on, halve, (0, x, x > 2))[1]

    numbers = np.full(num_lanes, 40.0)
    made = Program.of_trees(jax.vmap(halved, axis_name=LANES), numbers)
    given, compile_ = [], jax.stages.Lowered.compile
    graphs = "xla_gpu_enable_command_buffer"
    if by_user:
        monkeypatch.setenv("XLA_FLAGS", f"--{graphs}=+WHILE")
    monkeypatch.setattr(program, "_options", lambda *_: {} if by_user else {graphs: "FUSION,WHILE"})
    monkeypatch.setattr(
        jax.stages.Lowered, "compile", lambda self, options: [given.append(options), compile_(self)][1]
    )
    np.testing.assert_array_equal(made.compile("halved", DEVICE)(numbers), 1.25)
    first, *again = ((options or {}).get(graphs, "") for options in given)
    assert ("WHILE" in first) is not by_user
    assert [set(value.split(",")) >= {"FUSION"} and "WHILE" not in value for value in again] == (
        [True] if num_lanes == 1 and not has_kernel else []
    )


def test_texts_of_programs_with_and_without_a_bare_condition():
    def text_of(*conditions):
        loops = "".join(
            f"%region.{i}-clone (arg: (s32[], pred[])) -> pred[] {{\n"
            "  %arg = (s32[], pred[]) parameter(0)\n"
            f"  ROOT %root = pred[] {operation}(%arg), index=1\n}}\n\n"
            for i, operation in enumerate(conditions)
        )
        whiles = "".join(
            f"  %while.{i} = (s32[], pred[]) while(%tuple), condition=%region.{i}-clone, body=%body\n"
            for i in range(len(conditions))
        )
        return f"HloModule jit_program\n\n{loops}ENTRY %main () -> s32[] {{\n{whiles}}}\n"

    is_bare = program._has_bare_condition
    assert not is_bare(text_of())
    assert not is_bare(text_of("fusion", "compare"))
    assert is_bare(text_of("fusion", "get-tuple-element"))
    assert is_bare(text_of("opt-barrier", "fusion"))  # unknown operations may be no kernels
    assert is_bare("ENTRY %main () -> s32[] {\n  %w = s32[] while(%x), condition=%elsewhere, body=%b\n}\n")
    assert is_bare(None)


@pytest.mark.parametrize("settings", [POMCPOW, VOMCPOW, PFTDPW])
def test_the_loops_of_a_single_search_on_beliefs_compute_their_conditions(settings):
    problem, planner = build(VdpTag(), "float32"), build(settings(iterations=3, depth=2), "float32")
    keys = jax.random.split(jax.random.key(0))
    made = jax.make_jaxpr(lambda keys: planner.plan(keys[0], problem, initial(problem, keys[1], 4)))(keys)
    conditions = [condition.jaxpr for condition in conditions_of(made.jaxpr)]
    assert len(conditions) > 2
    assert all(condition.eqns[-1].outvars == condition.outvars for condition in conditions)


def conditions_of(jaxpr):
    """The conditions of all loops of a program."""
    for operation in jaxpr.eqns:
        for name, value in operation.params.items():
            if name == "cond_jaxpr":
                yield value
            for inner in value if isinstance(value, tuple | list) else (value,):
                inner = getattr(inner, "jaxpr", inner)
                if hasattr(inner, "eqns"):
                    yield from conditions_of(inner)
