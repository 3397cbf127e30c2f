"""Numbers only: bodies, equations of motion, contact, the frame kernel, neighbours. It knows no cyclist and no herd."""

import os
import sys
import tempfile

import warp as wp


def _initialize_warp() -> None:
    """Start Warp without its greeting and without its complaint that there is no GPU, which is no complaint of ours.

    The complaint comes from native code, straight to the file descriptor of standard error; whatever else arrives
    there meanwhile is passed on.
    """
    # A program that wants to hear what is loaded sets the level again after importing Echelon.
    if wp.config.log_level == wp.LOG_INFO:
        wp.config.log_level = wp.LOG_ERROR
    try:
        sys.stderr.flush()
        kept = os.dup(2)
    except (AttributeError, OSError):
        wp.init()  # no standard error to keep clean
        return
    with tempfile.TemporaryFile() as caught:
        os.dup2(caught.fileno(), 2)
        try:
            wp.init()
        finally:
            os.dup2(kept, 2)
            os.close(kept)
        caught.seek(0)
        for line in caught:
            if b"Could not find or load the NVIDIA CUDA driver" not in line:
                os.write(2, line)


_initialize_warp()
