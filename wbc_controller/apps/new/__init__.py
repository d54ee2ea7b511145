"""Drafts a configuration from a URDF: what `wbc new` prints.

`draft.py` runs the steps; each adds values to the draft, and notes on their origin: measured, guessed, or missing
(`notes.py`). Limits that are missing in the URDF get placeholders (`missing_limits.py`).

1. `mechanism.py`: joints, in the order of the URDF. Those that move less than 1/200 of the robot's mass, as fingers do,
   are locked.
2. `feet.py`: the ends of the kinematic tree are its joints without a joint below them, with all links that are fixed to
   them. Feet are the lowest end with the base upright, and the ends whose limbs have as many joints and about the same
   mass as its limb and that reach about as low. A robot stands on them, and so has a floating base, if there are two or
   more, no other part reaches as low, and the root link is not called ``world``. A hand hangs higher or ends another
   limb than the legs; the pedestal of an arm is lower than its hand.
3. `foot_shape.py`: a flat part below a foot makes a surface contact, a round one a point, and a body of revolution
   about the axis of a joint that turns without end a rolling wheel.
4. `posture.py`: the one of an SRDF, if the feet are level in it and the centre of mass is above them; otherwise the one
   nearest to it, or to straight limbs, with bent legs that fulfils both (`standing_posture.py`).
5. `tuning.py`: tasks, gains and limits, by similarity to the robots that are shipped: stiffnesses go with the
   squared frequency g/h of a pendulum as high as the centre of mass, and forces with the weight.
"""
