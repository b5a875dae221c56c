"""Common mistakes on the command line are answered with a hint."""

import pytest

from bojax.cli.main import main
from bojax.config.files import shipped
from tests.transcript import cases

HINTS = """\
run parking planner.iterations 50
=> did you mean planner.iterations=50?
sweep planner.iterations 50 parking
=> did you mean planner.iterations=50?
run parking 'planner={kind:' sbo, depth: '2}'
=> command line: planner: got {kind:; is not YAML
run parking 'planner={kind:' 'sbo}'
=> quote a value with braces or spaces: 'planner={kind: ...'
run parking planner=kind:sbo planner=depth:2
=> planner: given twice; quote a value with braces
run fig-4.2
=> is in sweeps/, not in configs/; start it with: bojax sweep fig-4.2
sweep taxi
=> is in configs/, not in sweeps/; start it with: bojax run taxi
run parking problem=mountain-car
=> this name has the role env, not problem; planners need a problem, learners an env (experiment: learning)
run mountain-car env=diagonal
=> this name has the role problem, not env; planners need a problem, learners an env
run parking planner=emu-q
=> this name has the role learner, not planner; allowed:
run parking planner.motions.actions=9
=> unknown key (a setting of kind=splines); allowed:
run parking planner.iterations=1e3
=> got 1000.0; allowed: an integer (write 1000)
run parking planner=kcbts,sbo
=> several values are an axis of a sweep file (axes: {KEY: [...]})
run parking planner.iterations=50,100
=> got "50,100"; allowed: an integer; several values are an axis of a sweep file
reproduce fig-4.6 --gpu
=> unknown option --gpu; GPUs are used if JAX is installed for them
run parking --planner.iterations=50
=> unknown option --planner.iterations; did you mean planner.iterations=50?
sweep parking --planner.iterations 50
=> did you mean planner.iterations=VALUE?
tune parking --planner=sbo
=> did you mean planner=sbo?
list --planner=x
=> unknown option --planner (see
sweep fig-5.3
=> fig-5.3: stands for fig-5.3-cliff, fig-5.3-taxi; start with: bojax reproduce fig-5.3
run table-5.3
=> start with: bojax reproduce table-5.3
sweep chapter5
=> chapter5: stands for many sweeps; start with: bojax reproduce chapter5
run kcbts
=> kcbts: is a part (role planner), not a name in configs/; choose it by planner=kcbts; bojax list kcbts
sweep rbf
=> rbf: is a part (role kernel), not a name in sweeps/; bojax list rbf shows more
reproduce mountain-car
=> got mountain-car, a config; start it with: bojax run mountain-car
reproduce parkin
=> did you mean "parking"?
run parking --runs 1e3
=> allowed: an integer (write 1000)
"""

WHOLE = """\
run parking planner.iterations=1.5
=> got 1.5; allowed: an integer
run parking planner.iterations=1_000
=> got "1_000"; allowed: an integer (write 1000)
run mountain-car 'env={kind: gymnasium, id: A-v0}' env.speed=3
=> max_steps, success, success_key, success_reward; did you mean "env.kwargs.speed"?
run mountain-car 'env={kind: gymnasium, id: A-v0}' env.max_step=3
=> did you mean "max_steps"?
"""
"""Messages that end with the hint."""

BREAKS = [
    ("sweep parking --out 'a\nb'", '--out: got "a\\nb"; allowed: a path on one line'),
    ("report 'a\tb'", 'got "a\\tb"; allowed: a path on one line'),
]


def test_hints(write, refusal):
    for words, hint in [*cases(HINTS), *BREAKS]:
        assert hint in refusal(words)
    for words, hint in cases(WHOLE):
        assert refusal(words).endswith(hint)


@pytest.mark.parametrize(("command", "folder"), [("run", "configs"), ("sweep", "sweeps")])
def test_a_file_that_hides_a_shipped_one_is_mentioned(monkeypatch, write, capsys, command, folder):
    monkeypatch.setattr("bojax.engine.run.run_sweeps", lambda *_, **__: 1)
    text = (shipped(folder) / "two-pits.yaml").read_text()
    write(f"{folder}/two-pits.yaml", text)
    assert main([command, "two-pits"]) == 1
    assert capsys.readouterr().err == "", "the same content"
    write(f"{folder}/two-pits.yaml", "{planner: sbo}" if folder == "configs" else "{base: {planner: sbo}}")
    for source, is_mentioned in (("two-pits", True), (f"{folder}/two-pits.yaml", False)):
        assert main([command, source]) == 1
        err = capsys.readouterr().err
        assert err.startswith(f"note: {folder}/two-pits.yaml hides ") is is_mentioned
        assert err.count("\n") == is_mentioned


@pytest.mark.parametrize(
    ("words", "note"),
    [
        (
            ["planner.motions.length=7"],
            "note: planner.motions.length: got 7 m: such paths may leave the domain, which is 6 m wide",
        ),
        (["planner.motions.length=6"], ""),
    ],
)
def test_paths_that_are_longer_than_the_domain_are_mentioned(monkeypatch, write, capsys, words, note):
    monkeypatch.setattr("bojax.engine.run.run_sweeps", lambda *_, **__: 1)
    assert main(["run", "two-pits", *words]) == 1
    err = capsys.readouterr().err
    assert err.startswith(note) and err.count("\n") == bool(note)
