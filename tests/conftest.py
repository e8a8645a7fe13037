"""Strict numerics for every test, set through the environment so that subprocesses have it too."""

import os
from pathlib import Path

_CACHE = Path(__file__).parent.parent / ".cache" / "jax"
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(_CACHE))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.2")
os.environ.setdefault("JAX_NUMPY_RANK_PROMOTION", "raise")
os.environ.setdefault("MPLBACKEND", "Agg")
os.environ.setdefault(
    "OPENBLAS_NUM_THREADS", "1"
)  # as the command line does, see `cli._limit_blas_threads`
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault(
    "XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false"
)  # a test process for each core is enough

from adaptsim_jax.core import process  # noqa: E402

process.keep_freed()  # as the command line does

import jax  # noqa: E402  (JAX reads the settings above when it is imported)
import pytest  # noqa: E402


@pytest.fixture
def x64():
    """Double precision for one test."""
    with jax.enable_x64(True):
        yield
