"""Common mistakes on the command line are answered with a hint."""

import pytest

from bojax.cli.main import main
from bojax.config.files import shipped

HINTS = {
    "a space for the equals sign": (
        ["run", "parking", "planner.iterations", "50"],
        "did you mean planner.iterations=50?",
    ),
    "the same in a sweep": (
        ["sweep", "planner.iterations", "50", "parking"],
        "did you mean planner.iterations=50?",
    ),
    "braces cut by spaces": (
        ["run", "parking", "planner={kind:", "sbo,", "depth:", "2}"],
        "command line: planner: got {kind:; is not YAML",
    ),
    "the advice": (
        ["run", "parking", "planner={kind:", "sbo}"],
        "quote a value with braces or spaces: 'planner={kind: ...'",
    ),
    "braces expanded by the shell": (
        ["run", "parking", "planner=kind:sbo", "planner=depth:2"],
        "planner: given twice; quote a value with braces",
    ),
    "a sweep for a config": (
        ["run", "fig-4.2"],
        "is in sweeps/, not in configs/; start it with: bojax sweep fig-4.2",
    ),
    "a config for a sweep": (
        ["sweep", "taxi"],
        "is in configs/, not in sweeps/; start it with: bojax run taxi",
    ),
    "an environment for a problem": (
        ["run", "parking", "problem=mountain-car"],
        "this name has the role env, not problem; planners need a problem, learners an env "
        "(experiment: learning)",
    ),
    "a problem for an environment": (
        ["run", "mountain-car", "env=diagonal"],
        "this name has the role problem, not env; planners need a problem, learners an env",
    ),
    "a learner for a planner": (
        ["run", "parking", "planner=emu-q"],
        "this name has the role learner, not planner; allowed: ",
    ),
    "a setting of another kind": (
        ["run", "parking", "planner.motions.actions=9"],
        "unknown key (a setting of kind=splines); allowed: ",
    ),
    "a float for an integer": (
        ["run", "parking", "planner.iterations=1e3"],
        "got 1000.0; allowed: an integer (write 1000)",
    ),
    "a fraction": (["run", "parking", "planner.iterations=1.5"], "got 1.5; allowed: an integer\n"),
    "groups of digits": (
        ["run", "parking", "planner.iterations=1_000"],
        'got "1_000"; allowed: an integer (write 1000)\n',
    ),
    "several kinds": (
        ["run", "parking", "planner=kcbts,sbo"],
        "several values are an axis of a sweep file (axes: {KEY: [...]})",
    ),
    "several numbers": (
        ["run", "parking", "planner.iterations=50,100"],
        'got "50,100"; allowed: an integer; several values are an axis of a sweep file',
    ),
    "several kinds to tune": (
        ["tune", "parking", "planner=kcbts,sbo"],
        "planner.exploration=0.1:10:log; compare several values by a sweep (axes: {KEY: [...]})",
    ),
    "a GPU": (
        ["reproduce", "fig-4.6", "--gpu"],
        "unknown option --gpu; GPUs are used if JAX is installed for them",
    ),
    "a setting with dashes": (
        ["run", "parking", "--planner.iterations=50"],
        "unknown option --planner.iterations; did you mean planner.iterations=50?",
    ),
    "a setting with dashes and a space": (
        ["sweep", "parking", "--planner.iterations", "50"],
        "did you mean planner.iterations=VALUE?",
    ),
    "a part with dashes": (["tune", "parking", "--planner=sbo"], "did you mean planner=sbo?"),
    "no settings in this command": (["list", "--planner=x"], "unknown option --planner (see"),
    "an argument of an environment": (
        ["run", "mountain-car", "env={kind: gymnasium, id: A-v0}", "env.speed=3"],
        'max_steps, success, success_reward; did you mean "env.kwargs.speed"?\n',
    ),
    "a misspelt setting of such an environment": (
        ["run", "mountain-car", "env={kind: gymnasium, id: A-v0}", "env.max_step=3"],
        'did you mean "max_steps"?\n',
    ),
    "a figure of several sweeps": (
        ["sweep", "fig-5.3"],
        "fig-5.3: stands for fig-5.3-cliff, fig-5.3-taxi; start with: bojax reproduce fig-5.3",
    ),
    "a table of several sweeps": (["run", "table-5.3"], "start with: bojax reproduce table-5.3"),
    "a chapter": (
        ["sweep", "chapter5"],
        "chapter5: stands for many sweeps; start with: bojax reproduce chapter5",
    ),
    "a line break in a path": (
        ["sweep", "parking", "--out", "a\nb"],
        '--out: got "a\\nb"; allowed: a path on one line',
    ),
    "a tab in a path": (["report", "a\tb"], 'got "a\\tb"; allowed: a path on one line'),
    "a float for an option": (["run", "parking", "--runs", "1e3"], "allowed: an integer (write 1000)"),
}


@pytest.mark.parametrize("case", HINTS)
def test_hints(write, capsys, case):
    words, hint = HINTS[case]
    assert main(words) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and hint in err


@pytest.fixture
def ran(monkeypatch):
    """Runs nothing."""
    monkeypatch.setattr("bojax.engine.run.run_sweeps", lambda *_, **__: 1)


@pytest.mark.parametrize(("command", "folder"), [("run", "configs"), ("sweep", "sweeps")])
def test_a_file_that_hides_a_shipped_one_is_mentioned(ran, write, capsys, command, folder):
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
