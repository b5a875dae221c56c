"""`import bojax` imports nothing heavy, and its functions are there when they are asked for."""

import subprocess
import sys

import bojax
from tests.cli.test_main import HEAVY

CODE = f"""
import sys
import bojax
print(*set({(*HEAVY, "pydantic", "yaml")!r}) & set(sys.modules))
"""


def test_it_imports_nothing_heavy():
    found = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, check=True)
    assert found.stdout.split() == []


def test_every_declared_name_is_there_and_no_other():
    declared = open(bojax.__file__ + "i").read()
    for name in bojax._HOMES:
        assert getattr(bojax, name) is not None
        assert name in dir(bojax)
        assert f" as {name}\n" in declared
    assert not hasattr(bojax, "swep")
