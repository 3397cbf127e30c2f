"""Whether an MPI launcher has started this process, as its environment says; nothing large is imported to know it."""

from __future__ import annotations

import os

_SIZES = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "MV2_COMM_WORLD_SIZE", "MPI_LOCALNRANKS")
"""Environment variables in which launchers (Open MPI, MPICH and Intel MPI, MVAPICH) say how many ranks there are."""

_RANKS = ("OMPI_COMM_WORLD_RANK", "PMI_RANK", "MV2_COMM_WORLD_RANK", "PMIX_RANK")


def launched_ranks() -> int:
    """How many ranks the launcher of this process has started; 1 where none has, or where it is alone."""
    sizes = [os.environ.get(name, "") for name in _SIZES]
    if "PMIX_RANK" in os.environ:  # Slurm's srun with PMIx
        sizes.append(os.environ.get("SLURM_STEP_NUM_TASKS", ""))
    return max([1, *(int(size) for size in sizes if size.isdecimal())])


def launched_rank() -> int:
    """The number of this process among them, as the launcher says."""
    found = [os.environ[name] for name in _RANKS if os.environ.get(name, "").isdecimal()]
    return int(found[0]) if found else 0
