"""A maneuver that is tuned in seconds: somebody who stands and bends the knees."""

SCRIPT = """\
name = "bend"
body = "male"                                   # of whom we know

[parameters]
# How deep.
deep = { value = 0.84, spread = 0.01, least = 0.70, most = 0.85, about = "from hip to ankle [m]" }
arms = { value = 0.1, least = 0.0, most = 1.5 } # forward [rad]
still = 0.15

[[row]]
name = "stand"
duration = 0.1
legs = { length = 0.84 }
channels = { shoulder = 0.1, shoulder_spread = "still" }
settings = { balance = 1.0 }
next = [{ to = "bent", when = { row_age = [0.1, inf] } }]

[[row]]
name = "bent"
duration = 0.2
legs = { length = "deep" }
channels = { shoulder = "arms" }
settings = { balance = 1.0 }
"""

OBJECTIVE = """\
title = "Knees bent by 0.8 rad"
script = "bend"
proof = 8

[[success]]
value = "fallen"
most = 0.5

[[success]]
about = "knees"
value = "knee"
least = 0.6
most = 1.0

[[stage]]
name = "bend"
tune = ["deep"]
seconds = 0.5
generations = 12
enough = 0.0002
population = 8

[[stage.term]]
about = "knees"
value = "knee"
target = 0.8
scale = 0.1

[[stage]]
name = "arms"
tune = ["deep", "arms"]
seconds = 0.5
copies = 2
generations = 3
population = 8
success_rate = 1.0
failures = 10.0

[[stage.term]]
about = "arms"
value = "abs(arms - 1)"
weight = 1.0

[[stage.term]]
about = "knees"
value = "knee"
at = "most"
row = "bent"
target = 0.8
scale = 0.1
"""
