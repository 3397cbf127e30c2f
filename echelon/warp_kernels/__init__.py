"""Numbers only: bodies, equations of motion, contact, the frame kernel, neighbours. It knows no cyclist and no herd."""
