"""Independent worlds that make "measured" data for the closed-loop suites; nothing here imports
`adaptsim_jax`.
"""

from tests.generators.dataset import Spec, make_dataset, make_datasets
from tests.generators.recording import Dataset, write_dataset

__all__ = ["Dataset", "Spec", "make_dataset", "make_datasets", "write_dataset"]
