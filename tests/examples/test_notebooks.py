"""The notebooks run: where JAX has already started with 32-bit numbers, and without a terminal."""

import ast
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.examples.pages import ROOT

NOTEBOOKS = sorted((ROOT / "examples").glob("*.ipynb"))

RUN = """
import ast, json, sys
import jax

assert jax.devices() and not jax.config.jax_enable_x64 and not sys.stderr.isatty()
cells, names = json.load(sys.stdin), {"__name__": "__main__"}
for number, cell in enumerate(cells):
    *body, last = ast.parse(cell).body
    if not isinstance(last, ast.Expr):
        body, last = [*body, last], None
    exec(compile(ast.Module(body, []), f"cell {number}", "exec"), names)
    if last is not None:
        value = eval(compile(ast.Expression(last.value), f"cell {number}", "eval"), names)
        show = getattr(value, "_repr_html_", lambda: repr(value))
        print(f"cell {number}:", len(show()), "nan" in repr(value))
"""
"""Runs the cells of a notebook in one namespace, and shows the value of the last line of each as one does."""


def cells_of(path: Path) -> list[str]:
    return [
        "".join(cell["source"])
        for cell in json.loads(path.read_text())["cells"]
        if cell["cell_type"] == "code"
    ]


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name)
def test_a_notebook_runs(path, tmp_path):
    cells = cells_of(path)
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1"}
    environment.pop("JAX_ENABLE_X64", None)
    command, options = [sys.executable, "-c", RUN], {"cwd": tmp_path, "env": environment, "text": True}
    ran = subprocess.run(command, input=json.dumps(cells), capture_output=True, timeout=900, **options)
    assert ran.returncode == 0, ran.stderr
    shown = [line for line in ran.stdout.splitlines() if line.startswith("cell ")]
    expressions = [cell for cell in cells if isinstance(ast.parse(cell).body[-1], ast.Expr)]
    assert len(shown) == len(expressions) and not any(line.endswith("True") for line in shown), ran.stdout
