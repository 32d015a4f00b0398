"""What the driver knows of karts: facts about the engine, measured in races.

A drift is a slide to the side to which the kart steers when it begins. It earns a boost when
it ends, if it has lasted long enough. The kart goes on turning for a while then, and
cannot begin another drift.
"""

from __future__ import annotations

#: Game time between two calls of the driver [s]; what counts steps below goes by it.
STEP = 0.1

#: In a drift the engine turns by these shares of full lock as steer goes from -1 to 1.
DRIFT_TURN = (0.2, 0.8)

#: Steps of drifting that earn the small boost (4.5 m/s), and the big one (6.5 m/s) ...
BOOST_STEPS = (11, 31)
#: ... which last so many steps, half the time in which they fade included.
BOOST_LASTS = (35, 45)

#: A drift begins with a hop: the next drift begins at least so many steps after this one began. A
#: kart that asks sooner gets it later, to the side to which it steers by then.
DRIFT_APART = 4

#: After a drift the kart goes on turning for as many steps as it has drifted, but no more than
#: this, and cannot drift ...
RELEASE_STEPS = 7
#: ... by this rate for each share of full lock with which the drift ended [rad/s].
RELEASE_TURN = 1.25 / 0.7

#: What the wheels still do of the step before, as a share of the step.
STEERING_LAG = 0.33

#: A rescue takes so many steps at most, in which the kart seems to go on at the speed that it had.
RESCUE_STEPS = 14

#: Deceleration with the brake on [m/s²].
BRAKING = 22.0
