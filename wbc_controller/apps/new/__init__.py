"""Draft of a configuration from a URDF, printed by `wbc new`.

`draft.py` runs the steps. Each adds values with notes on their origin: measured, guessed or missing (`notes.py`).

1. `mechanism.py`: joints in URDF order. Joints that move less than 1/200 of the mass, such as fingers, are locked.
   Missing limits get placeholders (`missing_limits.py`).
2. `feet.py`: feet are the lowest end of the kinematic tree and all ends of similar height on similar limbs. With two
   or more feet, no other part as low, and a root link not called ``world``, the base floats.
3. `foot_shape.py`: a flat sole makes a surface contact, a round foot a point contact, and a body of revolution about a
   continuous joint a rolling wheel.
4. `posture.py`: the SRDF's posture if the feet are level and the centre of mass is above them. Otherwise the nearest
   such posture, or one with bent legs (`standing_posture.py`).
5. `tuning.py`: tasks, gains and limits of the supplied robots. Stiffnesses scale with the squared pendulum frequency
   g/h at the height h of the centre of mass, forces with the weight.
"""
