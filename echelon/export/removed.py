"""Those who have been taken away from a run, and are not to be seen in what is made of it."""

from __future__ import annotations

import numpy as np

from echelon.recording import REMOVED_PHASE, Recording


def removed_agents(recording: Recording, frames: slice) -> np.ndarray:
    """Whether each agent has been taken away in some frames, bool, shape [frames, agents]."""
    phases = np.asarray(recording.phases[frames])
    names = list(recording.phase_names)
    return phases == names.index(REMOVED_PHASE) if REMOVED_PHASE in names else np.zeros(phases.shape, bool)


def places_to_frame(places: np.ndarray, removed: np.ndarray) -> np.ndarray:
    """Places of bodies as cameras are to frame them: who has been taken away counts as where the others are.

    Args:
        places: [m], shape [frames, bodies, 3].
        removed: Who has been taken away, shape [frames, bodies].
    """
    if not removed.any():
        return places
    there = ~removed[..., None]
    count = there.sum(axis=1, keepdims=True)
    middle = np.where(there, places, 0.0).sum(axis=1, keepdims=True) / np.maximum(count, 1)
    return np.where(there | (count == 0), places, middle)
