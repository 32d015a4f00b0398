"""Facts about karts in the engine, measured in races.

A drift is a slide to the side to which the kart steers when the drift begins. It earns a boost at
its end if it has lasted long enough. Afterwards the kart keeps turning for a while and cannot begin
another drift.
"""

from __future__ import annotations

#: Game time between two calls of the driver [s]; the steps below have this length.
STEP = 0.1

#: Turn in a drift for steering of -1 and 1 [fraction of full lock].
DRIFT_TURN = (0.2, 0.8)

#: Steps of drifting that earn the small boost (4.5 m/s) and the big boost (6.5 m/s).
BOOST_STEPS = (11, 31)
#: Duration of the boosts in steps, including half of the time in which they fade.
BOOST_LASTS = (35, 45)

#: Minimum steps between the beginnings of two drifts, because a drift begins with a hop. An earlier
#: request is delayed, and the drift then begins to the side to which the kart steers at that time.
DRIFT_APART = 4

#: After a drift the kart keeps turning, and cannot drift, for as many steps as it has drifted, but
#: at most this many.
RELEASE_STEPS = 7
#: Turning rate after a drift, per fraction of full lock at its end [rad/s].
RELEASE_TURN = 1.25 / 0.7

#: Lag of the wheels behind the steering, as a fraction of a step.
STEERING_LAG = 0.33

#: Maximum steps of a rescue, during which the kart reports the speed that it had before.
RESCUE_STEPS = 14

#: Deceleration of the brake [m/s²].
BRAKING = 22.0
