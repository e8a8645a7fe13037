"""The compile cache: on by default, elsewhere or off on demand, and never a reason to fail."""

import os
import subprocess
import sys

CODE = """
import sys
from adaptsim_jax import cli
args = cli.parse(["doctor", *sys.argv[1:]])
cli._set_up_cache(args)
import jax
print(jax.config.jax_enable_compilation_cache, jax.config.jax_compilation_cache_dir)
"""


def settings(*arguments, **env):
    names = ("JAX_COMPILATION_CACHE_DIR", "ADAPTSIM_CACHE", "XDG_CACHE_HOME")
    clean = {name: value for name, value in os.environ.items() if name not in names}
    command = [sys.executable, "-c", CODE, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, env={**clean, **env}, check=True)
    return done.stdout.strip(), done.stderr


def test_the_platform_folder_by_default(tmp_path):
    where = tmp_path / "adaptsim_jax" / "xla"
    assert settings(XDG_CACHE_HOME=str(tmp_path)) == (f"True {where}", "")
    assert where.is_dir()


def test_another_folder_or_none(tmp_path):
    assert settings(ADAPTSIM_CACHE=str(tmp_path / "c"))[0] == f"True {tmp_path / 'c'}"
    assert settings(JAX_COMPILATION_CACHE_DIR=str(tmp_path / "j"))[0] == f"True {tmp_path / 'j'}"
    assert settings("--no-cache", ADAPTSIM_CACHE=str(tmp_path / "c"))[0] == "False None"


def test_a_folder_that_cannot_be_made_is_said_and_done_without(tmp_path):
    (tmp_path / "file").write_text("")
    out, err = settings(ADAPTSIM_CACHE=str(tmp_path / "file" / "cache"))
    assert out == "False None"
    assert err.startswith("adaptsim: no compile cache: ") and err.count("\n") == 1
