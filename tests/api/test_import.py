"""`import bojax` is quick, and its functions are there when they are asked for."""

import subprocess
import sys

import bojax
from tests.cli.test_main import HEAVY

CODE = f"""
import sys, time
begin = time.perf_counter()
import bojax
seconds = time.perf_counter() - begin
print(seconds, *set({(*HEAVY, "pydantic", "yaml")!r}) & set(sys.modules))
"""


def test_it_takes_under_a_third_of_a_second_and_imports_nothing_heavy():
    found = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, check=True)
    seconds, *heavy = found.stdout.split()
    assert heavy == []
    assert float(seconds) < 0.3


def test_every_declared_name_is_there_and_no_other():
    declared = open(bojax.__file__ + "i").read()
    for name in bojax._HOMES:
        assert getattr(bojax, name) is not None
        assert name in dir(bojax)
        assert f" as {name}\n" in declared
    assert not hasattr(bojax, "swep")
